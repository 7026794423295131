"""Reads a run. Raw volts come out as they went in; oversampled channels are decimated here."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from piezo_rig.errors import InputError, PiezoRigError
from piezo_rig.run_file.layout import DETAIL_PREFIX, REQUIRED_ATTRIBUTES, SCHEMA_VERSION
from piezo_rig.run_file.sweep import HISTORIES, ORIGINS, Sweep


@dataclass(frozen=True)
class Entry:
    """What a run says of one sweep, without its data.

    Attributes
    ----------
    end_s : when it ended, on the run's clock
    stored_at : s since 1970 (UTC); None where the run does not say
    superseded_by : name of the sweep that was played in its stead; empty if none was
    """

    name: str
    condition: str
    repeat: int
    end_s: float
    stored_at: float | None
    superseded_by: str


class Run:
    """One run file, opened for reading and closed again after every access.

    ``sweep_names`` are all that it holds, ``active_names`` those that no other supersedes.

    Raises
    ------
    InputError : no run file, a newer one, or a damaged one
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        with self._open() as entry:
            version = int(entry.attrs.get("schema_version", -1))
            if version > SCHEMA_VERSION:
                raise InputError(
                    "run-newer",
                    f"{self.path}: schema {version}; this program reads up to {SCHEMA_VERSION}",
                    "the run was written by a newer piezo-rig", "update piezo-rig",
                )
            if version < 1:
                raise InputError(
                    "run-file", f"{self.path}: an HDF5 file, but not a piezo-rig run",
                    "another program wrote it", "give a run",
                )
            self.attributes = {k: _plain(v) for k, v in entry.attrs.items()}
            self.sweep_names = sorted(n for n in entry if n.startswith("sweep_"))
            self.active_names = [
                n for n in self.sweep_names if "superseded_by" not in entry[n].attrs
            ]
            self.texts = {
                k: _plain(v[()]) for k, v in entry.items()
                if isinstance(v, h5py.Dataset) and v.shape == () and v.dtype.kind in "SO"
            }
            clock = entry.get("clock_start")
            self.clock_start = float(clock[()]) if clock is not None else 0.0

    @property
    def origin(self) -> str:
        return str(self.attributes.get("origin", ""))

    @property
    def complete(self) -> bool:
        return bool(self.attributes.get("complete", False))

    def sha256(self) -> str:
        """Hash of the file's bytes, for provenance."""
        digest = hashlib.sha256()
        with self.path.open("rb") as handle:
            while block := handle.read(1 << 20):
                digest.update(block)
        return digest.hexdigest()

    @contextmanager
    def _open(self) -> Iterator[h5py.Group]:
        try:
            swmr = self.path.name.endswith(".part.h5")
            with h5py.File(self.path, "r", swmr=swmr) as f:
                if not isinstance(f.get("entry"), h5py.Group):
                    raise InputError(
                        "run-file", f"{self.path}: an HDF5 file, but not a piezo-rig run",
                        "another program wrote it", "give a run",
                    )
                yield f["entry"]
        except PiezoRigError:
            raise
        except (OSError, KeyError, RuntimeError, TypeError, ValueError, AttributeError,
                MemoryError, OverflowError, IndexError) as error:
            raise InputError(
                "run-file", f"{self.path}: cannot be read as a run: {_first_line(error)}",
                "the file is damaged, unfinished, or not a run",
                "take it from the backup; a recording of another program goes through "
                "'piezo-rig import'",
            ) from None

    def sweeps(self, names: list[str] | None = None) -> list[Sweep]:
        """The sweeps, those named or all that are not superseded, with their data.

        A sweep that carries the history of one that was played again stands alone: its history
        is unknown to whoever does not look at the other.
        """
        wanted = self.active_names if names is None else names
        with self._open() as entry:
            return [self._linked(_sweep(entry, name, self.path)) for name in wanted]

    def _linked(self, sweep: Sweep) -> Sweep:
        before = self.sweep_names[: self.sweep_names.index(sweep.name)][-1:]
        if sweep.history == "carried" and not set(before) <= set(self.active_names):
            return sweep.with_(history="unknown")
        return sweep

    def entries(self) -> list[Entry]:
        """What the run says of every sweep, the superseded ones too."""
        with self._open() as entry:
            return [_entry(entry[name]) for name in self.sweep_names]

    def events(self) -> list[dict[str, Any]]:
        """The event log."""
        with self._open() as entry:
            if "event_log" not in entry:  # imported
                return []
            text = entry["event_log"][...].tobytes().decode()
            return [json.loads(line) for line in text.splitlines()]

    def instruments(self) -> dict[str, dict[str, Any]]:
        """Identity and settings of every instrument."""
        with self._open() as entry:
            return {
                name: {k: _plain(v) for k, v in group.attrs.items()}
                | {"settings": json.loads(_plain(group["settings"][()]))}
                for name, group in entry.get("instrument", {}).items()
            }

    def actuator(self) -> dict[str, Any]:
        with self._open() as entry:
            sample = entry.get("sample")
            attributes = {} if sample is None else dict(sample.attrs)
            return {k: _plain(v) for k, v in attributes.items() if k != "NX_class"}


def _plain(value: Any) -> Any:
    """An HDF5 attribute or scalar as a Python value."""
    if isinstance(value, bytes):
        return value.decode()
    if isinstance(value, np.generic):
        return _plain(value.item())
    return value


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:200]


def _entry(group: h5py.Group) -> Entry:
    a = {k: _plain(v) for k, v in group.attrs.items()}
    return Entry(
        name=group.name.rsplit("/", 1)[1], condition=str(a["condition"]), repeat=int(a["repeat"]),
        end_s=float(a["start_time"]) + group["command_v"].size / float(a["sample_rate"]),
        stored_at=a.get("stored_at"), superseded_by=str(a.get("superseded_by", "")),
    )


def _sweep(entry: h5py.Group, name: str, path: Path) -> Sweep:
    group = entry[name]
    a = {k: _plain(v) for k, v in group.attrs.items()}
    missing = [k for k in REQUIRED_ATTRIBUTES if k not in a]
    if missing:
        raise InputError(
            "run-file", f"{path}: {name} lacks {', '.join(missing)}",
            "the file is damaged or was written by another program", "record it again",
        )
    if a["origin"] not in ORIGINS or a["history"] not in HISTORIES:
        raise InputError(
            "run-file", f"{path}: {name} has origin '{a['origin']}', history '{a['history']}'",
            "the file is damaged", f"origin is one of {ORIGINS}, history one of {HISTORIES}",
        )
    command = np.asarray(group["command_v"][...], dtype=float)
    factor = int(a.get("oversampling", 1))
    channels: dict[str, NDArray[np.float64] | None] = {}
    for channel in ("sensor_v", "drive_monitor_v"):
        data = group.get(channel)
        if data is None:
            channels[channel] = None
            continue
        volts = decimate(np.asarray(data[...], dtype=float), factor)
        if volts.shape != command.shape:
            raise InputError(
                "run-file", f"{path}: {name}: {channel} has {volts.size} samples, command_v "
                f"{command.size}", "the file is damaged", "check it with 'piezo-rig verify'",
            )
        channels[channel] = volts
    sensor = channels["sensor_v"]
    if sensor is None or sensor.size < 2:
        raise InputError(
            "run-file", f"{path}: {name} holds no sensor_v", "the file is damaged",
            "check it with 'piezo-rig verify'",
        )
    times = group.get("time_s")
    return Sweep(
        name=name, command_v=command, sensor_v=sensor, sample_rate=float(a["sample_rate"]),
        gain=float(a["gain"]), offset_v=float(a["offset_v"]),
        sensitivity_um_per_v=float(a["sensitivity_um_per_v"]), polarity=int(a["polarity"]),
        zero_v=float(a["zero_v"]), condition=str(a["condition"]), repeat=int(a["repeat"]),
        history=str(a["history"]), start_time=float(a["start_time"]), origin=str(a["origin"]),
        drive_monitor_v=channels["drive_monitor_v"],
        sample_times_s=None if times is None else np.asarray(times[...], dtype=float),
        source=str(path),
        resumed_after_s=a.get("resumed_after_s"), superseded_by=str(a.get("superseded_by", "")),
        details={
            k.removeprefix(DETAIL_PREFIX): v for k, v in a.items() if k.startswith(DETAIL_PREFIX)
        },
    )


def decimate(volts: NDArray[np.float64], factor: int) -> NDArray[np.float64]:
    """Every ``factor``-th sample behind a linear-phase low pass of zero delay."""
    if factor == 1:
        return volts
    from scipy.signal import resample_poly

    return np.asarray(resample_poly(volts, 1, factor, padtype="line"))
