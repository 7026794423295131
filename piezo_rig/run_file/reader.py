"""Reads a run. Raw volts come out as they went in; oversampled channels are decimated here."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from numpy.typing import NDArray

from piezo_rig.errors import InputError
from piezo_rig.run_file.guarded import (
    HDF5_ERRORS,
    Budget,
    Damaged,
    attributes,
    child,
    names,
    numbers,
    text,
)
from piezo_rig.run_file.layout import DETAIL_PREFIX, REQUIRED_ATTRIBUTES, SCHEMA_VERSION
from piezo_rig.run_file.opening import opened
from piezo_rig.run_file.sweep import HISTORIES, ORIGINS, Sweep

if TYPE_CHECKING:
    import xarray

    from piezo_rig.run_file.budget import DisplacementBudget

_BYTES_READ = ("event_log", "wire_transcript")
SWEEP_PREFIX = "sweep_"
LARGEST = 1e12  # of volts and micrometres; what is beyond is no measurement


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

    ``sweep_names`` are all that it holds, ``active_names`` those that no other supersedes,
    ``superseded`` names for each of the others the one that was played in its stead.
    ``unreadable`` names what stands in the run but cannot be read, with the reason.

    Raises
    ------
    InputError : no run file, a newer one, or a damaged one
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.unreadable: dict[str, str] = {}
        with self.opened_entry() as entry:
            self.attributes = attributes(entry)
            version = self.attributes.get("schema_version", -1)
            if isinstance(version, bool) or not isinstance(version, int) or version < 1:
                raise _not_a_run(self.path)
            if version > SCHEMA_VERSION:
                raise InputError(
                    "run-newer",
                    f"{self.path}: schema {version}; this program reads up to {SCHEMA_VERSION}",
                    "the run was written by a newer piezo-rig", "update piezo-rig",
                )
            listed = names(entry)
            self.sweep_names = [n for n in listed if n.startswith(SWEEP_PREFIX)]
            self.superseded = self._superseded(entry)
            self.active_names = [n for n in self.sweep_names if n not in self.superseded]
            self.texts = self._texts(entry, listed)
            self.clock_start = 0.0
            clock = entry.get("clock_start") if "clock_start" in listed else None
            if isinstance(clock, h5py.Dataset) and clock.shape == () and clock.dtype.kind in "fiu":
                self.clock_start = float(clock[()])

    def _superseded(self, entry: h5py.Group) -> dict[str, str]:
        """By name, what was played in a sweep's stead; only what stands in the run counts."""
        found: dict[str, str] = {}
        for name in self.sweep_names:
            try:
                group = child(entry, name, h5py.Group)
                if group is None or "superseded_by" not in group.attrs:
                    continue  # most of them: their other attributes need not be read here
                by = str(attributes(group).get("superseded_by", ""))
            except (*HDF5_ERRORS, Damaged):
                continue  # said when the sweep is read
            if by > name and by in self.sweep_names:
                found[name] = by
        return found

    def _texts(self, entry: h5py.Group, listed: Sequence[str]) -> dict[str, str]:
        found: dict[str, str] = {}
        for name in listed:
            if name.startswith(SWEEP_PREFIX) or name in (*_BYTES_READ, "clock_start"):
                continue
            try:
                thing = child(entry, name, (h5py.Dataset, h5py.Group))
                if isinstance(thing, h5py.Dataset) and thing.shape == ():
                    found[name] = text(entry, name) or ""
            except Damaged as damage:
                self.unreadable[name] = str(damage)
        return found

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
    def opened_entry(self) -> Iterator[h5py.Group]:
        """The open file's ``/entry``; what fails while it is open is an ``InputError``."""
        with opened(self.path) as f:
            entry = child(f, "entry", h5py.Group)
            if entry is None:
                raise _not_a_run(self.path)
            yield entry

    def sweeps(self, names: Sequence[str] | None = None) -> list[Sweep]:
        """The sweeps, those named or all that are not superseded, with their data.

        A sweep that carries the history of one that was played again stands alone: its history
        is unknown to whoever does not look at the other.
        """
        with self.opened_entry() as entry:
            budget = Budget(self.path)
            wanted = self.active_names if names is None else names
            return [self._linked(read_sweep(entry, name, self.path, budget)) for name in wanted]

    def each(self, names: Sequence[str] | None = None) -> Iterator[tuple[str, Sweep | InputError]]:
        """The same, one after the other; an error for what cannot be read."""
        with self.opened_entry() as entry:
            budget = Budget(self.path)
            seen: dict[int, str] = {}
            for name in self.active_names if names is None else names:
                try:
                    refuse_alias(entry, name, seen)
                    yield name, self._linked(read_sweep(entry, name, self.path, budget))
                except Damaged as damage:
                    yield name, _bad_sweep(self.path, name, str(damage))
                except InputError as error:
                    yield name, error

    def displacement_budget(self, sweep: Sweep) -> DisplacementBudget:
        """What the displacement of one of its sweeps is uncertain by.

        ``run.displacement_budget(sweep).u_um(sweep.displacement_um)`` is the standard uncertainty
        of every sample, um.
        """
        from piezo_rig.run_file.budget import budget_of

        return budget_of(sweep, self.texts)

    def _linked(self, sweep: Sweep) -> Sweep:
        before = self.sweep_names[: self.sweep_names.index(sweep.name)][-1:]
        if sweep.history == "carried" and self.superseded.keys() & before:
            return sweep.with_(history="unknown")
        return sweep

    def to_xarray(self, names: Sequence[str] | None = None) -> xarray.Dataset:
        """The sweeps, those named or all that are not superseded, as one dataset.

        Dimensions ``sweep`` (coordinates: name, condition, repeat, history, start and settings)
        and ``time`` (s from a sweep's first sample); shorter sweeps are filled up with NaN, and
        ``samples`` says where they end. Volts and what they make, each with its unit.

        Raises
        ------
        InputError : xarray is not installed, or the sweeps were not sampled alike
        """
        from piezo_rig.run_file.as_xarray import to_xarray

        return to_xarray(self, names)

    def entries(self) -> list[Entry]:
        """What the run says of every sweep, the superseded ones too.

        Raises
        ------
        InputError : it does not say it of one
        """
        with self.opened_entry() as entry:
            return [_entry(entry, name) for name in self.sweep_names]

    def events(self) -> list[dict[str, Any]]:
        """The event log.

        Raises
        ------
        InputError : it is there, but is not a log
        """
        with self.opened_entry() as entry:
            return parse_events(numbers(entry, "event_log", Budget(self.path), "u"))

    def wire_transcript(self) -> bytes:
        """Every byte that went over a line, as ``wire`` packed them; empty where none was kept."""
        with self.opened_entry() as entry:
            data = numbers(entry, "wire_transcript", Budget(self.path), "u")
            return b"" if data is None else data.astype(np.uint8).tobytes()

    def instruments(self) -> dict[str, dict[str, Any]]:
        """Identity and settings of every instrument."""
        with self.opened_entry() as entry:
            group = child(entry, "instrument", h5py.Group)
            found: dict[str, dict[str, Any]] = {}
            for name in [] if group is None else names(group):
                record = child(group, name, h5py.Group)
                said = attributes(record)
                settings = json.loads(text(record, "settings") or "{}")
                if not isinstance(settings, dict):
                    raise Damaged(f"the settings of {name} are no table")
                said["settings"] = {k: str(v) for k, v in settings.items()}
                found[name] = said
            return found

    def actuator(self) -> dict[str, Any]:
        with self.opened_entry() as entry:
            sample = child(entry, "sample", h5py.Group)
            said = {} if sample is None else attributes(sample)
            return {k: v for k, v in said.items() if k != "NX_class"}


def parse_events(log: NDArray[Any] | None) -> list[dict[str, Any]]:
    """Events of the bytes of a log; none where there is no log (imported).

    Raises
    ------
    Damaged : a line that is no event; ValueError where it is no JSON
    """
    if log is None:
        return []
    events = [json.loads(line) for line in log.astype(np.uint8).tobytes().splitlines()]
    for event in events:
        if not (
            isinstance(event, dict) and isinstance(event.get("event"), str)
            and isinstance(event.get("time_s"), int | float)
            and math.isfinite(event["time_s"])
        ):
            raise Damaged("event_log holds a line that is no event")
    return events


def _not_a_run(path: Path) -> InputError:
    return InputError(
        "run-file", f"{path}: an HDF5 file, but not a piezo-rig run",
        "another program wrote it", "give a run",
    )


def _bad_sweep(path: Path, name: str, what: str, remedy: str = "") -> InputError:
    return InputError(
        "run-file", f"{path}: {name}: {what}", "the file is damaged",
        remedy or "see 'piezo-rig verify'; take the file from the backup, or record it again",
    )


def _entry(entry: h5py.Group, name: str) -> Entry:
    group = child(entry, name, h5py.Group)
    command = None if group is None else child(group, "command_v", h5py.Dataset)
    if group is None or command is None:
        raise Damaged(f"{name} holds no command_v")
    a = sweep_attributes(group)
    return Entry(
        name=name, condition=a["condition"], repeat=a["repeat"],
        end_s=float(a["start_time"]) + command.size / float(a["sample_rate"]),
        stored_at=a.get("stored_at"), superseded_by=str(a.get("superseded_by", "")),
    )


def refuse_alias(entry: h5py.Group, name: str, seen: dict[int, str]) -> h5py.Group:
    """The group of a sweep; Damaged for one that was ``seen`` under another name."""
    group = child(entry, name, h5py.Group)
    if group is None:
        raise Damaged("is not there")
    if (other := seen.setdefault(hash(group.id), name)) != name:
        raise Damaged(f"is {other} under another name")
    return group


def sweep_attributes(
    group: h5py.Group, known: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The attributes of a sweep, each of its type and within what can be.

    ``known`` are those that stand elsewhere while a run is being recorded.

    Raises
    ------
    Damaged : one is missing, or is not what it should be
    """
    a = {**attributes(group), **(known or {})}
    missing = [k for k in REQUIRED_ATTRIBUTES if k not in a]
    if missing:
        raise Damaged(f"lacks {', '.join(missing)}")
    for key, allowed in (("origin", ORIGINS), ("history", HISTORIES)):
        if a[key] not in allowed:
            raise Damaged(f"{key} is {str(a[key])[:40]!r}, not one of {', '.join(allowed)}")
    for key in ("sample_rate", "gain", "offset_v", "sensitivity_um_per_v", "zero_v", "start_time"):
        if isinstance(a[key], bool | str) or not abs(a[key]) < 1e15:
            raise Damaged(f"{key} is {str(a[key])[:40]!r}")
    for key in ("sample_rate", "sensitivity_um_per_v"):
        if not a[key] > 0:
            raise Damaged(f"{key} is {a[key]:g}")
    if a["gain"] == 0:
        raise Damaged("gain is 0")
    if a["polarity"] not in (-1, 1):
        raise Damaged(f"polarity is {str(a['polarity'])[:40]!r}, neither -1 nor 1")
    a.setdefault("oversampling", 1)
    for key, most in (("repeat", 1_000_000), ("oversampling", 1000)):
        if isinstance(a[key], bool | str) or a[key] != int(a[key]) or not 1 <= a[key] <= most:
            raise Damaged(f"{key} is {str(a[key])[:40]!r}")
        a[key] = int(a[key])
    for key in ("stored_at", "resumed_after_s"):
        if key in a and (isinstance(a[key], bool | str) or not abs(a[key]) < 1e15):
            raise Damaged(f"{key} is {str(a[key])[:40]!r}")
    a["condition"] = str(a["condition"])
    if not a["condition"].isprintable() or len(a["condition"]) > 200:
        raise Damaged("its condition is not a name")
    return a


def read_sweep(
    entry: h5py.Group, name: str, path: Path, budget: Budget,
    known: Mapping[str, Any] | None = None,
) -> Sweep:
    """One sweep of an open run; ``known`` as in `sweep_attributes`.

    Raises
    ------
    InputError : it is missing or damaged
    """
    try:
        group = child(entry, name, h5py.Group)
        if group is None:
            raise Damaged("is not there")
        a = sweep_attributes(group, known)
        found = {
            channel: numbers(group, channel, budget)
            for channel in ("command_v", "sensor_v", "drive_monitor_v", "time_s")
        }
        return _sweep(name, path, a, found)
    except Damaged as damage:
        raise _bad_sweep(path, name, str(damage)) from None


def _sweep(
    name: str, path: Path, a: dict[str, Any], found: dict[str, NDArray[Any] | None]
) -> Sweep:
    """A sweep of its attributes and raw channels; Damaged where they do not fit together."""
    command, sensor = found["command_v"], found["sensor_v"]
    if command is None or sensor is None or command.size < 2:
        raise Damaged(f"holds no {'command_v' if command is None else 'sensor_v'}")
    factor = a["oversampling"]
    for channel, row in found.items():
        if row is not None and row.size and (np.abs(row.astype(float)) > LARGEST).any():
            raise Damaged(f"{channel} holds values that are no measurement")
    channels: dict[str, NDArray[np.float64] | None] = {}
    for channel in ("sensor_v", "drive_monitor_v"):
        raw = found[channel]
        if raw is not None and raw.size != command.size * factor:
            raise Damaged(
                f"{channel} has {raw.size} samples, command_v {command.size}"
                + (f", {factor} to one" if factor > 1 else "")
            )
        channels[channel] = None if raw is None else decimate(np.asarray(raw, float), factor)
    times = found["time_s"]
    if times is not None and times.size != command.size:
        raise Damaged(f"time_s has {times.size} samples, command_v {command.size}")
    sensor_v = channels["sensor_v"]
    assert sensor_v is not None
    return Sweep(
        name=name, command_v=np.asarray(command, float), sensor_v=sensor_v,
        sample_rate=float(a["sample_rate"]),
        gain=float(a["gain"]), offset_v=float(a["offset_v"]),
        sensitivity_um_per_v=float(a["sensitivity_um_per_v"]), polarity=int(a["polarity"]),
        zero_v=float(a["zero_v"]), condition=a["condition"], repeat=a["repeat"],
        history=a["history"], start_time=float(a["start_time"]), origin=a["origin"],
        drive_monitor_v=channels["drive_monitor_v"],
        sample_times_s=None if times is None else np.asarray(times, dtype=float),
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
