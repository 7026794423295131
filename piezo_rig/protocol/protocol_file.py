"""Protocol files: what a technician plays, in TOML.

A list where a single number is expected stands for several conditions
(``upper_v = [10, 15, 20]``); several lists in one table run together. See
``docs/protocols.md`` for every key.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from piezo_rig.config.toml_text import Document, Table
from piezo_rig.protocol.drive_file import STORED_BYTES, digest, pack, played
from piezo_rig.protocol.waveforms import Cycles, Hold, Route, Segment

_LISTABLE = ("lower_v", "upper_v", "frequency_hz", "slew_v_per_s", "level_v", "duration_s")
_WAVEFORMS = ("triangle", "sine", "hold", "blank", "steps", "turning-points", "file", "sequence")
LARGEST_V = 10_000.0  # of drive; a rig's own limits are far below
SLOWEST, FASTEST = 1e-6, 1e9  # Hz and V/s
MAX_CONDITIONS = 10_000
MAX_SEGMENTS = 10_000


@dataclass(frozen=True)
class Condition:
    """One condition: its name, its segments, and what identification wants to know of it."""

    name: str
    segments: tuple[Segment, ...]
    details: dict[str, float | str | int | bool] = field(default_factory=dict)
    line: int = 0


@dataclass(frozen=True)
class Protocol:
    """A protocol file, read and checked for sense (not yet against a rig)."""

    name: str
    description: str
    text: str
    path: str
    sample_rate: float
    repeats: int
    history: str
    order: str
    shuffle_seed: int
    approach_slew_v_per_s: float
    conditions: tuple[Condition, ...]
    rate_line: int = 0  # of sample_rate in the file; 0 where it stands on its default
    files: dict[str, str] = field(default_factory=dict)  # path, as given -> text

    def order_of(self, repeat: int) -> list[int]:
        """Indices of the conditions in the order in which one repeat (1-based) plays them."""
        indices = list(range(len(self.conditions)))
        if self.order == "shuffled":
            np.random.default_rng([self.shuffle_seed, repeat]).shuffle(indices)
        return indices


def load_protocol(path: Path) -> Protocol:
    """Read a protocol file.

    Raises
    ------
    InputError : names file, line and key
    """
    return parse_protocol(Document.load(path, "protocol", "protocol file"))


def recorded_protocol(text: str, run: str, files: dict[str, str]) -> Protocol:
    """The protocol that a run carries, with the files that it names.

    Raises
    ------
    InputError : names the run, line and key
    """
    return parse_protocol(Document(text, run, "protocol", files))


def parse_protocol(document: Document) -> Protocol:
    """A protocol from a parsed document."""
    root = document.root()
    root.text("schema", choices=("piezo-rig/protocol/1",))
    name = root.text("name", Path(document.name).stem)
    description = root.text("description", "")
    rate = root.number("sample_rate", 5000.0, low=1000.0, high=1e6)
    repeats = root.integer("repeats", 1, low=1, high=1000)
    history = root.text("history", "virgin", choices=("virgin", "carried"))
    order = root.text("order", "listed", choices=("listed", "shuffled"))
    seed = root.integer("shuffle_seed", 1, low=0)
    approach = root.number("approach_slew_v_per_s", 300.0, low=SLOWEST, high=FASTEST)
    conditions: list[Condition] = []
    for table in root.tables("condition"):
        for row in _rows(table):
            conditions.append(_condition(row))
            if len(conditions) > MAX_CONDITIONS:
                raise table.error("", f"more than {MAX_CONDITIONS} conditions")
    root.finish()
    if len(pack(document.companions)) > STORED_BYTES:
        raise root.error("condition", "the files that it plays are too large to be kept in a run",
                         "give fewer rows (straight lines are drawn between them), or fewer digits")
    return Protocol(
        name=name, description=description, text=document.text, path=document.name,
        sample_rate=rate, repeats=repeats, history=history, order=order, shuffle_seed=seed,
        approach_slew_v_per_s=approach, conditions=tuple(_with_unique_names(conditions)),
        rate_line=document.line(("sample_rate",)) if "sample_rate" in root else 0,
        files=dict(document.companions),
    )


def _rows(table: Table) -> list[Table]:
    """One table for each element of its lists."""
    lists = {k: v for k, v in table.data.items() if k in _LISTABLE and isinstance(v, list)}
    if not lists:
        return [table]
    lengths = {len(v) for v in lists.values()}
    if len(lengths) != 1 or 0 in lengths:
        raise table.error(
            next(iter(lists)), "lists in one table must have the same length, at least one: "
            + ", ".join(f"{k} has {len(v)}" for k, v in lists.items()),
        )
    (length,) = lengths
    return [
        Table(table.document, table.data | {k: v[i] for k, v in lists.items()}, table.path)
        for i in range(length)
    ]


def _condition(table: Table) -> Condition:
    given = table.text("name", "")
    waveform = table.text("waveform", choices=_WAVEFORMS)
    if waveform == "sequence":
        parts = [_simple(row) for t in table.tables("segments") for row in _rows(t)]
        if len(parts) > MAX_SEGMENTS:
            raise table.error("segments", f"more than {MAX_SEGMENTS} segments")
        table.finish()
        segments = tuple(s for part in parts for s in part.segments)
        levels = [
            float(v) for part in parts for k, v in part.details.items()
            if k in ("lower_v", "upper_v")
        ]
        condition = Condition(
            name=" ".join(part.name for part in (parts[0], parts[-1])),
            segments=segments,
            details={"waveform": "sequence", "lower_v": min(levels), "upper_v": max(levels)},
        )
    else:
        condition = _simple(table, waveform)
    telling = ("upper_v", "points_v", "levels_v", "level_v", "path", "segments", "waveform")
    key = next((k for k in telling if k in table), "waveform")
    line = table.document.line((*table.path, key))
    return replace(condition, name=given or condition.name, line=line)


def _simple(table: Table, waveform: str = "") -> Condition:
    waveform = waveform or table.text("waveform", choices=_WAVEFORMS[:-1])
    name, segments, details = _BUILDERS[waveform](table, waveform)
    table.finish()
    return Condition(name, segments, {"waveform": waveform, **details})


Built = tuple[str, tuple[Segment, ...], dict[str, float | str | int | bool]]


def _level(table: Table, key: str) -> float:
    return table.number(key, low=-LARGEST_V, high=LARGEST_V)


def _cycles(table: Table, waveform: str) -> Built:
    lower, upper = _level(table, "lower_v"), _level(table, "upper_v")
    if upper <= lower:
        raise table.error("upper_v", f"{upper:g} V must be above lower_v, {lower:g} V")
    start = table.text("start", "lower", choices=("lower", "upper"))
    if "slew_v_per_s" in table and waveform == "triangle":
        slew = table.number("slew_v_per_s", low=SLOWEST, high=FASTEST)
        frequency = slew / (2.0 * (upper - lower))
        if "frequency_hz" in table:
            raise table.error("slew_v_per_s", "give frequency_hz or slew_v_per_s, not both")
    else:
        frequency = table.number("frequency_hz", low=SLOWEST, high=1e5)
    cycles = table.integer("cycles", low=1, high=1_000_000)
    first, second = (lower, upper) if start == "lower" else (upper, lower)
    return (
        f"{first:g}-{second:g}",
        (Cycles(waveform, lower, upper, start, frequency, cycles),),
        {"lower_v": lower, "upper_v": upper, "start": start, "frequency_hz": frequency,
         "cycles": cycles},
    )


def _hold(table: Table, waveform: str) -> Built:
    level, duration = _level(table, "level_v"), table.number("duration_s", above=0.0, high=1e5)
    return (
        f"hold {level:g} V", (Hold(level, duration),),
        {"lower_v": min(0.0, level), "upper_v": max(0.0, level), "hold_s": duration},
    )


def _blank(table: Table, waveform: str) -> Built:
    duration = table.number("duration_s", above=0.0, high=1e5)
    return "blank", (Hold(0.0, duration),), {"lower_v": 0.0, "upper_v": 0.0, "hold_s": duration}


def _steps(table: Table, waveform: str) -> Built:
    levels = table.numbers("levels_v", low=-LARGEST_V, high=LARGEST_V)
    duration = table.number("hold_s", above=0.0, high=1e5)
    return (
        f"steps {levels[0]:g}..{levels[-1]:g}", tuple(Hold(v, duration) for v in levels),
        {"lower_v": min(0.0, *levels), "upper_v": max(0.0, *levels), "hold_s": duration},
    )


def _turning_points(table: Table, waveform: str) -> Built:
    levels = table.numbers("points_v", low=-LARGEST_V, high=LARGEST_V)
    if len(levels) < 2:
        raise table.error("points_v", "expected at least two turning points")
    slew = table.number("slew_v_per_s", low=SLOWEST, high=FASTEST)
    return (
        f"path {levels[0]:g}..{levels[-1]:g}", (Route(tuple(levels), slew),),
        {"lower_v": min(levels), "upper_v": max(levels), "slew_v_per_s": slew},
    )


def _file(table: Table, waveform: str) -> Built:
    path = table.text("path")
    text = table.document.companion(path, "a CSV with time_s,drive_v")
    segment = played(text, path, LARGEST_V)
    low, high = float(segment.drive_v.min()), float(segment.drive_v.max())
    return (
        f"file {Path(path).stem}", (segment,),
        {"path": path, "sha256": digest(text), "lower_v": low, "upper_v": high},
    )


_BUILDERS = {
    "triangle": _cycles, "sine": _cycles, "hold": _hold, "blank": _blank, "steps": _steps,
    "turning-points": _turning_points, "file": _file,
}


def _with_unique_names(conditions: list[Condition]) -> list[Condition]:
    """Names are what ``--only`` and a person use, so they must tell conditions apart."""
    shared = {n for n, times in Counter(c.name for c in conditions).items() if times > 1}
    named = [
        replace(c, name=f"{c.name} {c.details['frequency_hz']:.4g}Hz")
        if c.name in shared and "frequency_hz" in c.details else c
        for c in conditions
    ]
    taken: Counter[str] = Counter()
    result = []
    for c in named:
        taken[c.name] += 1
        result.append(c if taken[c.name] == 1 else replace(c, name=f"{c.name} ({taken[c.name]})"))
    return result
