"""Breaks in the catalogue's terms; several of one cause as lists."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from piezo_rig.causes.fringe_jump import STEP_NM
from piezo_rig.chain import Parameter
from piezo_rig.diagnosis.early.mended import JUMP, Break
from piezo_rig.diagnosis.early.traces import sweep_bounds
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.run_file.sweep import Sweep


@dataclass(frozen=True)
class Several(Parameter):
    """A parameter of several events: ``value`` is that of the first, ``values`` are all."""

    values: tuple[float, ...] = ()


def reported(
    groups: Groups, breaks: Sequence[Break], sweeps: Sequence[Sweep]
) -> dict[str, Parameter]:
    """Parameters of all breaks of one cause, in the order of the sweeps given.

    ``sweep`` says in which of these each is, from 1; index and time count from its first sample.
    """
    rows = []
    for b in breaks:
        group = groups.groups[b.group]
        bounds = sweep_bounds(group, b.row, sweeps)
        k = next(i for i, (begin, end) in enumerate(bounds) if begin <= b.index < end)
        sweep = group.sweeps[b.row][k]
        index = b.index - bounds[k][0]
        if b.cause == JUMP:
            step = b.count * STEP_NM
            rows.append((sweep, index, {"step": (step, "nm"),
                         "time": (float(sweeps[sweep].time_s[index]), "s")}))  # fmt: skip
        else:
            rows.append((sweep, index, {"index": (float(index), "1"),
                                        "count": (float(b.count), "1")}))  # fmt: skip
        rows[-1][2]["sweep"] = (sweep + 1.0, "1")
    rows.sort(key=lambda r: r[:2])
    out: dict[str, Parameter] = {}
    for name, (value, unit) in rows[0][2].items():
        if len(rows) == 1:
            out[name] = Parameter(value, unit)
        else:
            out[name] = Several(value, unit, None, tuple(r[2][name][0] for r in rows))
    return out
