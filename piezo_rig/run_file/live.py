"""A run as it stands, also while it is being recorded: how far it is, and its latest sweep.

Read only, without a lock, opened and closed again for every look: the writer cannot notice.
What it counts as stored is whole (decision 2); a look that falls between two of its writes is
an `InputError`, and the next one is good.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py

from piezo_rig.errors import InputError
from piezo_rig.run_file.guarded import Budget, Damaged, attributes, child, names, numbers, text
from piezo_rig.run_file.layout import PART_SUFFIX
from piezo_rig.run_file.opening import opened
from piezo_rig.run_file.reader import SWEEP_PREFIX, Run, parse_events, read_sweep
from piezo_rig.run_file.sweep import Sweep

_LOCKS = Path("/proc/locks")


@dataclass(frozen=True)
class Stored:
    """One sweep that is on the disk: when it began, and how long it is (s, the run's clock)."""

    name: str
    condition: str
    repeat: int
    start_s: float
    duration_s: float
    stored_at: float | None


@dataclass(frozen=True)
class Look:
    """A run at one moment.

    Attributes
    ----------
    recording : whether it is being recorded; a part file of a program that is gone is, too
    stored : sweeps on the disk, in the order of time
    left_s : durations of the sweeps that are planned and not stored
    events : its log
    closed_whole : whether it was closed with all that was planned
    """

    path: Path
    title: str
    origin: str
    recording: bool
    stored: tuple[Stored, ...]
    left_s: tuple[float, ...]
    clock_start: float
    events: list[dict[str, Any]] = field(default_factory=list)
    closed_whole: bool = False

    @property
    def planned(self) -> int:
        return len(self.stored) + len(self.left_s)

    def seconds_left(self, now: float) -> float | None:
        """Wall-clock seconds until the last sweep is stored, at the pace of those that are.

        ``now`` in seconds since 1970; None while nothing is stored.
        """
        if not self.recording or not self.stored:
            return None
        last = self.stored[-1]
        played = sum(s.duration_s for s in self.stored)
        between = last.start_s + last.duration_s - self.clock_start - played
        bench_s = sum(self.left_s) + len(self.left_s) * max(0.0, between) / len(self.stored)
        first = self.stored[0]
        pace = 1.0
        if first.stored_at and last.stored_at and last.start_s > first.start_s:
            passed = last.start_s + last.duration_s - first.start_s - first.duration_s
            pace = (last.stored_at - first.stored_at) / max(passed, 1e-9)
        since = max(0.0, now - last.stored_at) if last.stored_at else 0.0
        return max(0.0, pace * bench_s - since)

    def flags(self, sweep: str = "") -> list[dict[str, Any]]:
        """Flags of the log, of one sweep or of all."""
        return [
            e for e in self.events
            if e.get("event") == "flag" and (not sweep or e.get("sweep") == sweep)
        ]

    @property
    def doing(self) -> str:
        """What the log says last, in words; flags stand elsewhere."""
        said = [e for e in self.events if e["event"] != "flag"]
        if not said:
            return ""
        event = said[-1]
        if event["event"] == "playing":
            if event.get("sweep") in {s.name for s in self.stored}:
                return f"at rest after {event.get('sweep')}"
            return f"playing {event.get('sweep')}, {event.get('condition')}"
        if event["event"] == "error":
            return f"error[{event.get('code')}]: {event.get('what')}"
        return str(event["event"])


def begun(given: Path) -> bool:
    """Whether there is a run of that name; of a folder, whether one is being recorded there."""
    if given.is_dir():
        return any(not writer_is_gone(part) for part in given.glob("*" + PART_SUFFIX))
    return given.is_file() or any(path.is_file() for path in _named(given))


def both_paths(given: Path) -> tuple[Path, Path]:
    """The part file and the run that a name means; of a folder the latest of either.

    Raises
    ------
    InputError : a folder without runs, no such run, or a file that is none
    """
    if given.is_dir():
        found = [*given.glob("*" + PART_SUFFIX)]
        found = found or [*given.glob("*.h5")]
        if not found:
            raise InputError("file-missing", f"{given}: holds no run", "nothing was begun there",
                             "give a run, or the folder that 'run --out' names")
        given = max(found, key=lambda p: (p.stat().st_mtime, p.name))
    if given.suffix != ".h5" and given.is_file():
        raise InputError("run-file", f"{given}: not a run file", "another file",
                         "give a run file (.h5), or the folder that 'run --out' names")
    part, path = _named(given)
    if not (part.exists() or path.is_file()):
        raise InputError("file-missing", f"{given}: no such run",
                         "a slip in the name, or nothing was begun",
                         "give a run file (.h5), or the folder that 'run --out' names")
    return part, path


def _named(given: Path) -> tuple[Path, Path]:
    stem = given.name.removesuffix(PART_SUFFIX).removesuffix(".h5")
    return given.with_name(stem + PART_SUFFIX), given.with_name(stem + ".h5")


def look(given: Path) -> Look:
    """The run as it stands; one that is resumed is shown by what is being added to it.

    Raises
    ------
    InputError : there is none, or this look fell between two writes
    """
    part, path = both_paths(given)
    if part.exists():
        with opened(part) as f:
            return _look_at_part(part, _entry(f, part))
    return _look_at_run(Run(path))


def latest(seen: Look) -> tuple[Sweep | None, Sweep | None]:
    """The sweep stored last, and the one before it with the same condition; None: there is none."""
    if not seen.stored:
        return None, None
    last = seen.stored[-1]
    same = [s for s in seen.stored[:-1] if s.condition == last.condition]
    wanted = [last.name, *(s.name for s in same[-1:])]
    if not seen.recording:
        found = Run(seen.path).sweeps(wanted)
    else:
        with opened(seen.path) as f:
            entry, budget = _entry(f, seen.path), Budget(seen.path)
            zeros = numbers(entry["recording"], "zero_v", budget)
            order = _sweep_names(entry)
            assert zeros is not None
            starts = {s.name: s.start_s for s in seen.stored}
            found = [
                read_sweep(entry, name, seen.path, budget, {
                    "zero_v": float(zeros[order.index(name)]), "start_time": starts[name],
                })
                for name in wanted
            ]
    return found[0], (found[1] if len(found) > 1 else None)


def writer_is_gone(part: Path) -> bool:
    """Whether no living program holds a part file; False where the system does not say.

    The system's own list of locks is read; trying the lock could stand in the writer's way.
    """
    try:
        inode = part.stat().st_ino
        return not any(
            line.split()[1] == "FLOCK" and line.split()[5].endswith(f":{inode}")
            for line in _LOCKS.read_text().splitlines() if len(line.split()) > 5
        )
    except (OSError, IndexError):
        return False


def _entry(f: h5py.File, path: Path) -> h5py.Group:
    entry = child(f, "entry", h5py.Group)
    if entry is None or child(entry, "recording", h5py.Group) is None:
        raise InputError("run-file", f"{path}: not a run that is being recorded",
                         "another program wrote it", "give a run")
    return entry


def _sweep_names(entry: h5py.Group) -> list[str]:
    return [n for n in names(entry) if n.startswith(SWEEP_PREFIX)]


def _look_at_part(part: Path, entry: h5py.Group) -> Look:
    budget = Budget(part)
    book = {
        key: numbers(entry["recording"], key, budget)
        for key in ("n_valid", "start_time", "stored_at")
    }
    stored, left = [], []
    for index, name in enumerate(_sweep_names(entry)):
        group = child(entry, name, h5py.Group)
        command = child(group, "command_v", h5py.Dataset)
        said = attributes(group)
        rate = float(said.get("sample_rate", 0.0))
        if command is None or not rate > 0:
            raise Damaged(f"{name} does not say how long it is")
        valid, start, at = (
            None if row is None or index >= row.size else float(row[index])
            for row in book.values()
        )
        if not valid or start is None or not math.isfinite(start):
            left.append(command.size / rate)
            continue
        stored.append(Stored(
            name, str(said.get("condition", "")), int(said.get("repeat", 1)), start,
            command.size / rate, at if at is not None and math.isfinite(at) else None,
        ))
    clock = entry["clock_start"][()] if "clock_start" in entry else 0.0
    return Look(
        path=part, title=text(entry, "title") or "", origin=str(attributes(entry).get("origin")),
        recording=True, stored=tuple(stored), left_s=tuple(left), clock_start=float(clock),
        events=parse_events(numbers(entry, "event_log", budget, "u")),
    )


def _look_at_run(run: Run) -> Look:
    stored = []
    with run.opened_entry() as entry:
        for e in run.entries():
            if e.superseded_by:
                continue
            group = entry[e.name]
            duration = group["command_v"].size / float(group.attrs["sample_rate"])
            stored.append(Stored(
                e.name, e.condition, e.repeat, e.end_s - duration, duration, e.stored_at
            ))
    missing = max(0, int(run.attributes.get("planned_sweeps", len(stored))) - len(stored))
    return Look(
        path=run.path, title=run.texts.get("title", ""), origin=run.origin, recording=False,
        stored=tuple(stored), left_s=(0.0,) * missing, clock_start=run.clock_start,
        events=run.events(), closed_whole=run.complete,
    )
