"""Turns a part file into a run: at the end of a run, or after a crash.

A part that resumes a run is joined to it, with the seam and what was played again marked.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from piezo_rig.errors import InputError
from piezo_rig.run_file.disk import sync
from piezo_rig.run_file.layout import GUARD_SUFFIX, NEW_SUFFIX, PART_SUFFIX

GROWING = ("event_log", "wire_transcript")
BOOK = ("n_valid", "zero_v", "start_time", "stored_at")

Event = dict[str, Any]


def close_part(part: Path, path: Path, events: Sequence[Event] = ()) -> Path:
    """Copy the played sweeps of ``part`` into a plain HDF5 file at ``path``; remove the part.

    ``path`` appears, or changes, whole or not at all. A part without a single sweep becomes a run
    without sweeps: its log says why. A part that resumes ``path`` is joined to it.

    Parameters
    ----------
    events : added to the log; so is what the guard has reported, if it had to act
    """
    draft = path.with_name(path.name + ".tmp")
    draft.unlink(missing_ok=True)
    report = path.with_name(path.name.removesuffix(".h5") + GUARD_SUFFIX)
    try:
        events = [*events, *_reported(report)]
        with h5py.File(part, "r", swmr=True) as source:
            joined = path.exists() and _holds(path, source["entry"])
            if joined:
                pass  # by a program that was killed before it could remove the part
            elif source["entry"].attrs.get("resumes"):
                _join(source["entry"], path, draft, events)
            elif path.exists():
                raise FileExistsError(17, f"{path} exists already")
            else:
                _copy(source, draft, events)
        if not joined:
            sync(draft)
            os.replace(draft, path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise
    sync(path.parent)
    part.unlink()
    report.unlink(missing_ok=True)
    return path


def _holds(path: Path, part: h5py.Group) -> bool:
    """Whether the run at ``path`` holds this part already."""
    with h5py.File(path, "r") as run:
        held = str(run["entry"].attrs.get("session", "")).split()
    return str(part.attrs.get("session", "-")) in held


def _copy(source: h5py.File, draft: Path, events: Sequence[Event]) -> None:
    """The counted sweeps and everything else of a part, with their attributes completed."""
    with h5py.File(draft, "w", track_order=True) as f:
        f.attrs.update(dict(source.attrs))
        old = source["entry"]
        entry = f.create_group("entry", track_order=True)
        entry.attrs.update({k: v for k, v in old.attrs.items() if k != "resumes"})
        for name in old:
            if not name.startswith("sweep_"):
                old.copy(old[name], entry, name)
        _copy_sweeps(old, entry)
        _append_events(entry, events)
        _complete(entry, planned=len(_sweep_names(old)))


def _join(part: h5py.Group, path: Path, draft: Path, events: Sequence[Event]) -> None:
    """The run at ``path`` and, after a seam, the counted sweeps of a part."""
    shutil.copyfile(path, draft)
    with h5py.File(draft, "r+") as f:
        entry = f["entry"]
        end_s = max((_end_s(entry[name]) for name in _sweep_names(entry)), default=None)
        names = _copy_sweeps(part, entry)
        if names and end_s is not None:
            first = entry[names[0]].attrs
            first["resumed_after_s"] = float(first["start_time"]) - end_s
        for name in names:
            superseded = str(entry[name].attrs.get("supersedes", ""))
            if superseded in entry:
                entry[superseded].attrs["superseded_by"] = name
        for name in GROWING:
            _append(entry[name], part[name][...])
        _append_events(entry, events)
        book = entry["recording"]
        for name in set(BOOK).intersection(book, part["recording"]):
            values = np.concatenate([book[name][...], part["recording"][name][...]])
            del book[name]
            book[name] = values
        entry.attrs["session"] = f"{entry.attrs.get('session', '')} {part.attrs['session']}"
        _complete(entry, planned=int(entry.attrs["planned_sweeps"]))


def _sweep_names(entry: h5py.Group) -> list[str]:
    return sorted(n for n in entry if n.startswith("sweep_"))


def _end_s(sweep: h5py.Group) -> float:
    a = sweep.attrs
    return float(a["start_time"]) + sweep["command_v"].size / float(a["sample_rate"])


def _copy_sweeps(old: h5py.Group, entry: h5py.Group) -> list[str]:
    """The counted sweeps of a part into a run, with their attributes; returns their names."""
    book = old["recording"]
    valid = book["n_valid"][...]
    copied = []
    for index, name in enumerate(_sweep_names(old)):
        if valid[index] == 0:
            continue
        old.copy(old[name], entry, name)
        for key in BOOK[1:]:
            if key in book:
                entry[name].attrs[key] = float(book[key][index])
        copied.append(name)
    return copied


def _complete(entry: h5py.Group, planned: int) -> None:
    """Whether everything planned was played, and the default plot."""
    names = [n for n in _sweep_names(entry) if "superseded_by" not in entry[n].attrs]
    entry.attrs["complete"] = len(names) >= planned
    entry.attrs["planned_sweeps"] = planned
    if "loop" in entry:
        del entry["loop"]
    write_loop(entry)


def _append_events(entry: h5py.Group, events: Sequence[Event]) -> None:
    """Events that the writer did not live to log, at the time of the last one that it logged."""
    if not events:
        return
    lines = entry["event_log"][...].tobytes().decode().splitlines()
    time_s = json.loads(lines[-1])["time_s"] if lines else 0.0
    text = "".join(json.dumps({"time_s": time_s, **event}) + "\n" for event in events)
    _append(entry["event_log"], np.frombuffer(text.encode(), dtype=np.uint8))


def _append(dataset: h5py.Dataset, data: np.ndarray) -> None:
    start = dataset.shape[0]
    dataset.resize((start + data.size,))
    dataset[start:] = data


def recover(folder: Path) -> list[Path]:
    """Close every part file that a killed program left in ``folder``.

    Returns the runs that came out of it. A part that another program is still writing, or that
    cannot be read, stays where it is.
    """
    for new in folder.glob("*" + NEW_SUFFIX):
        if not _in_use(new):  # killed before anything could be recorded
            new.unlink(missing_ok=True)
    recovered = []
    for part in sorted(folder.glob("*" + PART_SUFFIX)):
        if _in_use(part):
            continue
        stem = part.name.removesuffix(PART_SUFFIX)
        try:
            path = part.with_name(stem + ".h5")
            recovered.append(close_part(part, path, [{"event": "recovered"}]))
        except (OSError, KeyError, RuntimeError, ValueError):
            continue
    return recovered


def find_run(given: Path) -> Path:
    """The run that is meant, after `recover`: a part file stands for the run that came out of it.

    Raises
    ------
    InputError : there is none, or it is still being recorded
    """
    stem = given.name.removesuffix(PART_SUFFIX).removesuffix(".h5")
    part, path = given.with_name(stem + PART_SUFFIX), given.with_name(stem + ".h5")
    if part.exists():
        busy = _in_use(part)
        raise InputError(
            "run-busy" if busy else "run-file",
            f"{part} " + ("is being recorded" if busy else "cannot be recovered"),
            "another 'run' writes it" if busy else "it is damaged",
            "wait for it" if busy else "begin a new run",
        )
    if not path.is_file():
        raise InputError("file-missing", f"{given}: no such run", "a slip in the name",
                         "give a run file (.h5)")
    return path


def _reported(report: Path) -> list[Event]:
    """What the guard did after the runner was killed or stood still."""
    try:
        return [{"event": "guard", **json.loads(report.read_text(encoding="utf-8"))}]
    except (OSError, ValueError):
        return []


def _in_use(part: Path) -> bool:
    """Whether a living writer holds the file; see ``RunWriter``."""
    with part.open("rb") as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return True
        fcntl.flock(handle, fcntl.LOCK_UN)
    return False


def write_loop(entry: h5py.Group) -> None:
    """The default plot: displacement over drive of the sweep with the largest drive near 65 V.

    The thesis validates on 0-65 V; where that condition was not played, the sweep with the
    widest drive is shown. A sweep that was played again is not.
    """
    names = [n for n in _sweep_names(entry) if "superseded_by" not in entry[n].attrs]
    if not names:
        return

    def span(name: str) -> float:
        group = entry[name]
        return abs(float(group.attrs["gain"])) * float(np.ptp(group["command_v"][...]))

    chosen = next((n for n in names if entry[n].attrs["condition"] == "0-65"), None)
    group = entry[chosen or max(names, key=span)]
    a = group.attrs
    step = int(a["oversampling"])
    loop = entry.create_group("loop", track_order=True)
    loop.attrs.update(
        NX_class="NXdata", signal="displacement", axes=np.array(["drive_voltage"], dtype="S"),
        title=f"{a['condition']}, repeat {a['repeat']}", sweep=group.name.rsplit("/", 1)[1],
    )
    for name, values, units, label in (
        ("displacement",
         a["polarity"] * (group["sensor_v"][::step] - a["zero_v"]) * a["sensitivity_um_per_v"],
         "um", "displacement (um)"),
        ("drive_voltage", a["gain"] * group["command_v"][...] + a["offset_v"],
         "V", "drive on the actuator (V)"),
    ):
        dataset = loop.create_dataset(name, data=np.asarray(values, dtype=np.float64))
        dataset.attrs.update(units=units, long_name=label)
