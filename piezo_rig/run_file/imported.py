"""Writes recordings into a run: the same file as a run from the bench, origin IMPORTED."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np

from piezo_rig import __version__
from piezo_rig.errors import BenchError
from piezo_rig.run_file.close import write_loop
from piezo_rig.run_file.disk import sync
from piezo_rig.run_file.layout import CHUNK, DETAIL_PREFIX, SCHEMA_VERSION, UNITS
from piezo_rig.run_file.sweep import Sweep

_PLAIN = (
    "sample_rate", "gain", "offset_v", "sensitivity_um_per_v", "polarity", "zero_v", "condition",
    "repeat", "history", "start_time", "origin",
)


def write_imported(sweeps: Sequence[Sweep], path: Path, assumptions: Sequence[str]) -> Path:
    """Store sweeps that were read from recordings.

    Raises
    ------
    BenchError : the file exists already, or the disk refuses it (exit 4); nothing is overwritten
    """
    draft = path.with_name(path.name + ".tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists():
            raise FileExistsError(17, "it exists already; nothing is overwritten")
        with h5py.File(draft, "w", track_order=True) as f:
            f.attrs.update(NX_class="NXroot", default="entry", creator="piezo-rig")
            entry = f.create_group("entry", track_order=True)
            entry.attrs.update(
                NX_class="NXentry", default="loop", schema_version=SCHEMA_VERSION,
                origin="IMPORTED", complete=True, planned_sweeps=len(sweeps),
            )
            entry["title"] = path.stem
            entry["software_version"] = __version__
            entry["notes"] = "\n".join(assumptions)
            for sweep in sweeps:
                _write_sweep(entry, sweep)
            write_loop(entry)
        sync(draft)
        os.replace(draft, path)
        sync(path.parent)
    except OSError as error:
        draft.unlink(missing_ok=True)
        raise BenchError(
            "disk", f"could not write {path}: {error.strerror or error}",
            "the name is taken, or the disk or folder does not take the file",
            "give another --out",
        ) from None
    return path


def _write_sweep(entry: h5py.Group, sweep: Sweep) -> None:
    group = entry.create_group(sweep.name)
    group.attrs["NX_class"] = "NXcollection"
    group.attrs["oversampling"] = 1
    group.attrs["source"] = sweep.source
    for key in _PLAIN:
        group.attrs[key] = getattr(sweep, key)
    for key, value in sweep.details.items():
        group.attrs[DETAIL_PREFIX + key] = value
    channels = {
        "command_v": sweep.command_v, "sensor_v": sweep.sensor_v,
        "drive_monitor_v": sweep.drive_monitor_v, "time_s": sweep.sample_times_s,
    }
    for name, values in channels.items():
        if values is None:
            continue
        dataset = group.create_dataset(
            name, data=np.asarray(values, dtype=np.float64), chunks=(min(values.size, CHUNK),),
            shuffle=True, compression="gzip", compression_opts=1, fletcher32=True,
        )
        dataset.attrs["units"] = UNITS.get(name, "s")
