"""Events in the catalogue's terms, one by one and as parameters; several of one cause as lists."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from piezo_rig.causes.fringe_jump import STEP_NM
from piezo_rig.chain import Parameter
from piezo_rig.diagnosis.early.mended import DROP, JUMP, Break
from piezo_rig.diagnosis.early.spikes import Spike
from piezo_rig.diagnosis.early.traces import sweep_bounds
from piezo_rig.diagnosis.events import Event
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.run_file.sweep import Sweep


@dataclass(frozen=True)
class Several(Parameter):
    """A parameter of several events: ``value`` is that of the first, ``values`` are all."""

    values: tuple[float, ...] = ()


def events_of(
    groups: Groups, found: Sequence[Break | Spike], sweeps: Sequence[Sweep]
) -> tuple[Event, ...]:
    """What was found of one cause, in the order of the sweeps given and in time."""
    out = []
    for f in found:
        group = groups.groups[f.group]
        bounds = sweep_bounds(group, f.row, sweeps)
        k = next(i for i, (begin, end) in enumerate(bounds) if begin <= f.index < end)
        number, begin = group.sweeps[f.row][k], bounds[k][0]
        sweep = sweeps[number]
        low, here, high = (
            float(sweep.time_s[min(max(i - begin, 0), sweep.samples - 1)])
            for i in (f.low, f.index, f.high)
        )
        size, unit = _size(f)
        out.append(Event(
            number + 1, sweep.name, sweep.condition, sweep.repeat,
            Path(sweep.source).name or sweep.name, f.index - begin, here, (low, high), size, unit,
            (f.group, f.row, f.index),
        ))  # fmt: skip
    return tuple(sorted(out, key=lambda e: (e.number, e.index)))


def _size(found: Break | Spike) -> tuple[float, str]:
    if isinstance(found, Spike):
        return found.height_nm, "nm"
    if found.cause == JUMP:
        return found.count * STEP_NM, "nm"
    return float(found.count), "samples"


def reported(cause: str, events: Sequence[Event]) -> dict[str, Parameter]:
    """Parameters of all breaks of one cause.

    ``sweep`` says in which of the sweeps given each is, from 1; index and time count from its
    first sample.
    """
    columns: dict[str, tuple[str, list[float]]] = {}
    if cause == DROP:
        columns["index"] = "1", [float(e.index) for e in events]
        columns["count"] = "1", [e.size for e in events]
    else:
        columns["step"] = "nm", [e.size for e in events]
        columns["time"] = "s", [e.time_s for e in events]
    columns["sweep"] = "1", [float(e.number) for e in events]
    if len(events) == 1:
        return {name: Parameter(values[0], unit) for name, (unit, values) in columns.items()}
    return {
        name: Several(values[0], unit, None, tuple(values))
        for name, (unit, values) in columns.items()
    }
