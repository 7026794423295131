"""Turns a part file into a run: at the end of a run, or after a crash."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

import h5py
import numpy as np

from piezo_rig.run_file.disk import sync
from piezo_rig.run_file.layout import PART_SUFFIX


def close_part(part: Path, path: Path) -> Path:
    """Copy the played sweeps of ``part`` into a plain HDF5 file at ``path``; remove the part.

    ``path`` appears whole or not at all. A part without a single sweep becomes a run without
    sweeps: its log says why.
    """
    draft = path.with_name(path.name + ".tmp")
    draft.unlink(missing_ok=True)
    try:
        _copy(part, draft)
        sync(draft)
        os.replace(draft, path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise
    sync(path.parent)
    part.unlink()
    return path


def _copy(part: Path, draft: Path) -> None:
    """The counted sweeps and everything else of a part, with their attributes completed."""
    with h5py.File(part, "r", swmr=True) as source, h5py.File(draft, "w", track_order=True) as f:
        f.attrs.update(dict(source.attrs))
        old = source["entry"]
        entry = f.create_group("entry", track_order=True)
        entry.attrs.update(dict(old.attrs))
        book = old["recording"]
        valid = book["n_valid"][...]
        names = sorted(n for n in old if n.startswith("sweep_"))
        for name in old:
            if not name.startswith("sweep_"):
                old.copy(old[name], entry, name)
        for index, name in enumerate(names):
            if valid[index] == 0:
                continue
            old.copy(old[name], entry, name)
            entry[name].attrs["zero_v"] = float(book["zero_v"][index])
            entry[name].attrs["start_time"] = float(book["start_time"][index])
        entry.attrs["complete"] = bool(np.all(valid > 0))
        entry.attrs["planned_sweeps"] = len(names)
        write_loop(entry)
        f.flush()


def recover(folder: Path) -> list[Path]:
    """Close every part file that a killed program left in ``folder``.

    Returns the runs that came out of it. A part that another program is still writing, or that
    cannot be read, stays where it is.
    """
    recovered = []
    for part in sorted(folder.glob("*" + PART_SUFFIX)):
        path = part.with_name(part.name.removesuffix(PART_SUFFIX) + ".h5")
        if path.exists() or _in_use(part):
            continue
        try:
            recovered.append(close_part(part, path))
        except (OSError, KeyError, RuntimeError):
            continue
    return recovered


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
    widest drive is shown.
    """
    names = sorted(n for n in entry if n.startswith("sweep_"))
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
