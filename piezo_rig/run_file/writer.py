"""Writes a run so that a killed program loses at most the sweep being played.

Everything is created first, then the file goes into HDF5's single-writer
mode: one sweep, one flush, and only then its count of valid samples. On
closing, the run is copied into a plain file under its final name.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import struct
import time
import uuid
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import h5py
import numpy as np
from numpy.typing import ArrayLike

from piezo_rig.errors import BenchError
from piezo_rig.run_file.close import close_part
from piezo_rig.run_file.disk import sync
from piezo_rig.run_file.layout import (
    CHUNK,
    DETAIL_PREFIX,
    LOG_CHUNK,
    NEW_SUFFIX,
    PART_SUFFIX,
    SCHEMA_VERSION,
    UNITS,
    WIRE_CHUNK,
    RunHeader,
    SweepHeader,
)

WIRE_HEAD = struct.Struct("<dBBI")  # seconds, instrument, direction, length of what follows
RESERVE = 4_000_000  # bytes for logs, the transcript and the file system itself
DIRECTIONS = ("out", "in", "event")
METADATA_BYTES = (256 * 1024, 128 * 1024, 512 * 1024)  # at first, least, most


def part_path(path: Path) -> Path:
    """Where a run is recorded before it is closed."""
    return path.with_name(path.name.removesuffix(".h5") + PART_SUFFIX)


class RunWriter:
    """The run that is being recorded.

    Parameters
    ----------
    path : final name, ``*.h5``; must not exist
    header, sweeps : what is known beforehand
    resumes : ``path`` exists, and what is recorded is joined to it when the run is closed

    Raises
    ------
    BenchError : the disk refused (exit 4); the message names the part file that remains
    """

    def __init__(
        self, path: Path, header: RunHeader, sweeps: Sequence[SweepHeader], resumes: bool = False
    ) -> None:
        self.path = path
        self.resumes = resumes
        self.part = part_path(path)
        self.header = header
        self.sweeps = list(sweeps)
        self._wire: list[bytes] = []
        self._names = [i.name for i in header.instruments]
        with self._disk("create the run file"):
            self.part.parent.mkdir(parents=True, exist_ok=True)
            if path.exists() != resumes or self.part.exists():
                raise FileExistsError(17, "exists already, or is not there to be resumed")
            # Until it is in single-writer mode a file whose writer is killed cannot be read.
            # Nothing is in it by then, and nobody sees it under a part's name.
            new = self.part.with_name(self.part.name.removesuffix(PART_SUFFIX) + NEW_SUFFIX)
            self._file = h5py.File(new, "w-", libver="latest", track_order=True)
            self._create()
            self._file.swmr_mode = True
            _bound_metadata(self._file)
            # HDF5 gives up its own lock in this mode. A shared one tells `recover` that the
            # writer lives, and lets readers in.
            self._alive = new.open("rb")
            fcntl.flock(self._alive, fcntl.LOCK_SH)
            self._file.flush()
            sync(new)
            os.rename(new, self.part)
            sync(self.part.parent)  # its name, too, survives a power cut

    def _disk(self, doing: str) -> _DiskGuard:
        return _DiskGuard(doing, self.part)

    def _create(self) -> None:
        f, header = self._file, self.header
        f.attrs.update(NX_class="NXroot", default="entry", creator="piezo-rig")
        entry = f.create_group("entry")
        entry.attrs.update(
            NX_class="NXentry", default="loop", schema_version=SCHEMA_VERSION,
            origin=header.origin, session=uuid.uuid4().hex, resumes=self.resumes,
        )
        for name in (
            "title", "protocol_text", "plan_hash", "rig_config", "rig_path", "operator",
            "start_time",
            "software_version", "git_revision",
        ):
            _text(entry, name, getattr(header, name))
        _text(entry, "calibrations", json.dumps(header.calibrations, sort_keys=True))
        _text(entry, "calibration_texts", json.dumps(header.calibration_texts, sort_keys=True))
        if header.protocol_files:
            _text(entry, "protocol_files", header.protocol_files)
        _text(entry, "notes", "\n".join(header.notes))
        entry.create_dataset("clock_start", data=header.clock_start).attrs["units"] = "s"
        sample = entry.create_group("sample")
        sample.attrs["NX_class"] = "NXsample"
        for key, value in header.actuator.items():
            sample.attrs[key] = value
        instruments = entry.create_group("instrument")
        instruments.attrs["NX_class"] = "NXinstrument"
        for record in header.instruments:
            group = instruments.create_group(record.name)
            group.attrs.update(NX_class="NXcollection", idn=record.idn, serial=record.serial)
            _text(group, "settings", json.dumps(record.settings, sort_keys=True))
        for sweep in self.sweeps:
            self._create_sweep(entry, sweep)
        book = entry.create_group("recording")
        count = len(self.sweeps)
        book.create_dataset("n_valid", data=np.zeros(count, dtype=np.int64))
        book.create_dataset("zero_v", data=np.full(count, np.nan))
        book.create_dataset("start_time", data=np.full(count, np.nan))
        book.create_dataset("stored_at", data=np.full(count, np.nan))
        for name, chunk in (("event_log", LOG_CHUNK), ("wire_transcript", WIRE_CHUNK)):
            entry.create_dataset(
                name, shape=(0,), maxshape=(None,), dtype=np.uint8, chunks=(chunk,),
                compression="gzip", compression_opts=1, fletcher32=True,
            )

    def _create_sweep(self, entry: h5py.Group, sweep: SweepHeader) -> None:
        group = entry.create_group(sweep.name)
        group.attrs["NX_class"] = "NXcollection"
        group.attrs["sample_rate"] = sweep.sample_rate
        group.attrs["oversampling"] = sweep.oversampling
        for name in ("gain", "offset_v", "sensitivity_um_per_v", "polarity", "condition",
                     "repeat", "history"):
            group.attrs[name] = getattr(sweep, name)
        group.attrs["origin"] = self.header.origin
        if sweep.supersedes:
            group.attrs["supersedes"] = sweep.supersedes
        for key, value in sweep.details.items():
            group.attrs[DETAIL_PREFIX + key] = value
        measured = sweep.samples * sweep.oversampling
        channels: list[tuple[str, int, Any]] = [
            ("command_v", sweep.samples, np.float64), ("sensor_v", measured, np.float32)
        ]
        if self.header.monitor:
            channels.append(("drive_monitor_v", measured, np.float32))
        for name, size, dtype in channels:
            dataset = group.create_dataset(
                name, shape=(size,), dtype=dtype, chunks=(min(size, CHUNK),), shuffle=True,
                compression="gzip", compression_opts=1, fletcher32=True, fillvalue=np.nan,
            )
            dataset.attrs["units"] = UNITS[name]

    def require_room(self, index: int) -> None:
        """Refuse the next sweep if the disk could not take it and the closing copy as well.

        Raises
        ------
        BenchError : too little room; what was recorded can still be closed (exit 4)
        """
        sweep = self.sweeps[index]
        channels = 2 if self.header.monitor else 1
        next_bytes = sweep.samples * (8 + 4 * channels * sweep.oversampling)
        held = self.part.stat().st_size + (self.path.stat().st_size if self.resumes else 0)
        need = held + 3 * next_bytes + RESERVE
        free = shutil.disk_usage(self.part.parent).free
        if free < need:
            raise BenchError(
                "disk-full",
                f"before {sweep.name}: {free / 1e6:.1f} MB left in {self.part.parent}, "
                f"{need / 1e6:.1f} MB needed to store it and to close the run",
                "the disk is filling up", "make room and start again",
            )

    def write_sweep(
        self, index: int, command_v: ArrayLike, sensor_v: ArrayLike,
        drive_monitor_v: ArrayLike | None, start_time: float,
    ) -> None:
        """Store one sweep for good; returns when it is flushed.

        ``index`` counts from 0 in the order of the headers; ``start_time`` in seconds of the
        run's clock. The sensor's first sample becomes the sweep's zero.
        """
        header = self.sweeps[index]
        with self._disk(f"store {header.name}"):
            group = self._file["entry"][header.name]
            group["command_v"][...] = command_v
            sensor = np.asarray(sensor_v, dtype=np.float32)
            group["sensor_v"][...] = sensor
            if self.header.monitor and drive_monitor_v is not None:
                group["drive_monitor_v"][...] = drive_monitor_v
            book = self._file["entry/recording"]
            book["zero_v"][index] = float(sensor[0])
            book["start_time"][index] = start_time
            book["stored_at"][index] = time.time()
            self._append_wire()
            self._flush()
            if shutil.disk_usage(self.part.parent).free < 65_536:
                raise OSError(28, "No space left: the sweep may not have reached the disk")
            book["n_valid"][index] = header.samples
            self._flush()

    def log(self, time_s: float, event: str, **fields: object) -> None:
        """Add one event; on disk with the next flush."""
        line = json.dumps({"time_s": round(time_s, 6), "event": event, **fields}) + "\n"
        with self._disk("write the event log"):
            self._append("event_log", line.encode())
            self._file["entry/event_log"].flush()

    def wire(self, time_s: float, instrument: str, direction: str, data: bytes) -> None:
        """Remember bytes that went over a line; on disk with the next sweep."""
        if instrument not in self._names:
            return
        self._wire.append(
            WIRE_HEAD.pack(
                time_s, self._names.index(instrument), DIRECTIONS.index(direction), len(data)
            ) + data
        )

    def _append_wire(self) -> None:
        if self._wire:
            data, self._wire = b"".join(self._wire), []
            self._append("wire_transcript", data)

    def _append(self, name: str, data: bytes) -> None:
        dataset = self._file["entry"][name]
        start = dataset.shape[0]
        dataset.resize((start + len(data),))
        dataset[start:] = np.frombuffer(data, dtype=np.uint8)

    def _flush(self) -> None:
        self._file.flush()
        sync(self.part)

    def finish(self) -> Path:
        """Close the run and give it its final name; what was not played is left out."""
        with self._disk("close the run file"):
            self._append_wire()
            self._flush()
            self._let_go()
            return close_part(self.part, self.path)

    def release(self) -> None:
        """Let go of the part file without closing the run (the disk is full, say)."""
        with self._disk("release the run file"):
            self._let_go()

    def _let_go(self) -> None:
        self._file.close()
        self._alive.close()


class _DiskGuard:
    """Turns what a disk can do wrong into one error."""

    def __init__(self, doing: str, part: Path) -> None:
        self.doing, self.part = doing, part

    def __enter__(self) -> None:
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if isinstance(error, OSError | RuntimeError) and not isinstance(error, BenchError):
            full = "28" in str(error) or "No space" in str(error)
            raise BenchError(
                "disk-full" if full else "disk",
                f"could not {self.doing}: {error}",
                "the disk is full" if full else "the disk or the folder does not take the file",
                f"what was recorded so far is in {self.part}; make room and start again "
                "(it is recovered by itself)",
            ) from None


def _bound_metadata(file: h5py.File) -> None:
    """Keep HDF5 from holding every sweep's description in memory for a day (docs/endurance.md)."""
    config = file.id.get_mdc_config()
    config.set_initial_size = True
    config.initial_size, config.min_size, config.max_size = METADATA_BYTES
    file.id.set_mdc_config(config)


def _text(group: h5py.Group, name: str, text: str) -> None:
    """A fixed-length UTF-8 scalar: variable-length data cannot live in single-writer mode."""
    data = text.encode()
    group.create_dataset(
        name, data=data, dtype=h5py.string_dtype("utf-8", max(1, len(data)))
    )
