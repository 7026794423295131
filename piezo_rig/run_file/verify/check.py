"""Goes through a run, sweep by sweep, and gathers what the checks find."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from piezo_rig.errors import InputError
from piezo_rig.run_file.guarded import Budget, Damaged, child, numbers
from piezo_rig.run_file.layout import PART_SUFFIX, UNITS
from piezo_rig.run_file.reader import Run, refuse_alias, sweep_attributes
from piezo_rig.run_file.verify.calibration import Recorded, check_calibration, odd_ones_out
from piezo_rig.run_file.verify.flags import with_flags
from piezo_rig.run_file.verify.monitor import Followed, followed, judge
from piezo_rig.run_file.verify.run_checks import check_run
from piezo_rig.run_file.verify.superseded import as_notes, check_claims
from piezo_rig.run_file.verify.sweep_checks import Channels, check_channels, check_repeats
from piezo_rig.run_file.verify.timeline import check_times, events_of
from piezo_rig.run_file.verify.verdict import Verdict


def verify(path: Path) -> tuple[list[str], list[Verdict]]:
    """Check one run file.

    Returns
    -------
    names of all sweeps, and everything that was found: the run first, then sweep by sweep

    Raises
    ------
    InputError : not a run at all
    """
    run = Run(path)
    if path.name.endswith(PART_SUFFIX):
        return _unfinished(run)
    found: list[Verdict] = []
    recorded = Recorded.of(run)
    read: dict[str, dict[str, Any]] = {}
    monitors: dict[str, Followed] = {}
    outlines: dict[str, tuple[str, np.ndarray]] = {}
    seen: dict[Any, str] = {}
    with run.opened_entry() as entry:
        budget = Budget(path)
        for name in run.sweep_names:
            try:
                group = refuse_alias(entry, name, seen)
                a = read[name] = sweep_attributes(group)
                problems, channels = _channels(group, budget)
            except Damaged as damage:
                found.append(Verdict(name, True, str(damage)))
                continue
            problems += check_calibration(a, recorded, run.origin)
            if channels is not None:
                problems += check_channels(a, channels, recorded, run.origin)
                if channels.monitor_v is not None and "drive_monitor_v" in group:
                    monitors[name] = followed(a, channels)
                elif recorded.monitor_wired and "drive_monitor_v" not in group:
                    problems.append((True, "drive_monitor_v is missing, though it was wired"))
                if not any(fault for fault, _ in problems):
                    condition = f"{a['condition']}|{a['history']}"
                    outlines[name] = condition, channels.outline_um(a)
            found += [Verdict(name, fault, text) for fault, text in problems]
        found += check_run(run, entry, read)
    found += check_claims(run, read)
    found += odd_ones_out(read)
    found += check_times(run, read)
    # A sweep that was played again does not vote on those that count.
    found += judge({n: m for n, m in monitors.items() if n not in run.superseded})
    found += [v for v in judge(monitors) if v.sweep in run.superseded]
    explained = {v.sweep for v in found if v.fault} | run.superseded.keys()
    found += check_repeats({n: o for n, o in outlines.items() if n not in explained})
    found = as_notes(run, with_flags(found, events_of(run), run.sweep_names))
    order = {name: i for i, name in enumerate(["", *run.sweep_names])}
    return run.sweep_names, sorted(found, key=lambda v: order.get(v.sweep, 0))


def _channels(
    group: h5py.Group, budget: Budget
) -> tuple[list[tuple[bool, str]], Channels | None]:
    """What is wrong with the rows of numbers of a sweep; the rows where nothing is."""
    problems: list[tuple[bool, str]] = []
    rows: dict[str, np.ndarray] = {}
    for channel, unit in {**UNITS, "time_s": "s"}.items():
        try:
            row = numbers(group, channel, budget)
        except Damaged as damage:
            problems.append((True, str(damage)))
            continue
        if row is None:
            if channel in ("command_v", "sensor_v"):
                problems.append((True, f"{channel} is missing"))
            continue
        said = group[channel].attrs.get("units", "nothing")
        said = said.decode("latin-1") if isinstance(said, bytes) else str(said)
        if said != unit:
            problems.append((True, f"{channel} is in {said[:20]!r}, not in {unit}"))
        rows[channel] = row
    if "command_v" not in rows or "sensor_v" not in rows:
        return problems, None
    return problems, Channels(
        command_v=rows["command_v"].astype(float), sensor_v=rows["sensor_v"].astype(float),
        monitor_v=rows["drive_monitor_v"].astype(float) if "drive_monitor_v" in rows else None,
        time_s=rows["time_s"].astype(float) if "time_s" in rows else None,
    )


def _unfinished(run: Run) -> tuple[list[str], list[Verdict]]:
    """A recording that was never closed; its sweeps are for whoever recovers it."""
    with run.opened_entry() as entry:
        book = child(entry, "recording", h5py.Group)
        valid = None if book is None else numbers(book, "n_valid", Budget(run.path))
        if valid is None:
            raise Damaged("it has no count of what was recorded")
    text = (f"an unfinished recording with {np.count_nonzero(valid)} of {valid.size} sweeps; the "
            "next 'run' in this folder recovers it")
    return [], [Verdict("", True, text)]


def usable(path: Path) -> set[str]:
    """Names of the sweeps of a run that count and may be used.

    Raises
    ------
    InputError : not a run
    """
    _, found = verify(path)
    return set(Run(path).active_names) - {v.sweep for v in found if v.fault and v.sweep}


def require_run(path: Path) -> Path:
    """The path, if it is a file at all."""
    if path.is_dir():
        raise InputError(
            "file-missing", f"{path}: a folder, not a run", "a slip in the name",
            "give a run file (.h5)",
        )
    if not path.is_file():
        raise InputError(
            "file-missing", f"{path}: no such run", "a slip in the name", "give a run file (.h5)"
        )
    return path
