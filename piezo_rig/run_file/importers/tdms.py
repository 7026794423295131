"""LabVIEW's binary recordings (.tdms), through nptdms.

nptdms is kept on a leash: it reads from memory, never from an index file that happens
to lie beside the recording, and a file that makes it work longer, or claim more
samples, than its size can justify is refused.
"""

from __future__ import annotations

import io
import logging
import time
import warnings as python_warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from piezo_rig.errors import InputError
from piezo_rig.run_file.guarded import plain
from piezo_rig.run_file.importers.guards import read_bytes, refuse_mislabelled
from piezo_rig.run_file.importers.recording import Column, Recording
from piezo_rig.run_file.importers.said import MARK, Said, said_in
from piezo_rig.run_file.importers.tdms_segments import MOST, missing_bytes, starts
from piezo_rig.run_file.importers.words import is_time
from piezo_rig.run_file.sweep import FloatArray

CODE = "import-tdms"
_PATIENCE_S = 2.0  # for any file, and then ...
_FIRST_MB_S, _MORE_MB_S = 1.0, 5.0  # ... for each megabyte of it
_MOST_SCALES = 100
_MOST_JITTER = 10.0  # steps; a start time may be taken by software
_MOST_CHANNELS = 2000


def read_tdms(path: Path) -> list[Recording]:
    """The channels of a TDMS file that hold numbers, of all its groups, as one recording.

    Raises
    ------
    InputError : not a TDMS file, no channel with numbers in it, or damaged
    """
    data = read_bytes(path)
    refuse_mislabelled(path, data, own=b"TDSm")
    if not data.startswith(b"TDSm"):
        raise InputError(
            CODE,
            f"{path}: is not a TDMS file",
            cause="it does not begin with the mark TDSm: the wrong extension, or damage",
            remedy="copy it again from the computer that recorded it",
        )
    file = _PatientFile(data)
    with _guarded(path) as complaints:
        channels, without = _channels(path, file)
    if (missing := missing_bytes(data)) and without:
        raise InputError(
            CODE,
            f"{path}: ends before its data do: channel {without[0]} holds no sample",
            cause=f"the file was cut off: {missing} bytes that it says it has are missing",
            remedy="copy it again from the computer that recorded it",
        )
    if not channels:
        raise InputError(
            CODE,
            f"{path}: holds no channel with numbers in it",
            cause="the recording was stopped at once, or the file was cut off",
        )
    said = _said(path, channels)
    times: dict[str, int] = {}  # the first time channel of each group
    for i, channel in enumerate(channels):
        if _is_time(channel):
            times.setdefault(channel.group_name, i)
    whole = Recording(
        path=path,
        kind="tdms",
        columns=tuple(_column(path, channel, times, said) for channel in channels),
        load=partial(_load, path, channels),
        where=lambda sample: f"sample {sample}",
        positional=True,
        said=said,
        warnings=_told(complaints),
    )
    return [whole] if said else _in_parts(path, data, channels, whole)


def _in_parts(path: Path, data: bytes, channels: list[Any], whole: Recording) -> list[Recording]:
    """The recording, cut where segments give start times that do not follow from what is before."""
    begins = starts(data)
    steps = {column.step_s for column in whole.columns if not column.is_time}
    step = next(iter(steps)) if len(steps) == 1 else None
    if len(begins) < 2 or any(c.is_time for c in whole.columns) or not step or step < 0:
        return [whole]
    samples = len(channels[0])
    edges, stamps, jitter = [0], [begins[0].stamp_s], 0.0
    even = len(begins) <= MOST and all(len(channel) == samples for channel in channels)
    for start in begins[1:] if even else []:
        with _guarded(path):
            before, _ = _channels(path, _PatientFile(data[: start.position]))
            lengths = {len(channel) for channel in before}
        if len(lengths) != 1 or len(before) != len(channels):
            even = False
            break
        at = lengths.pop()
        late = start.stamp_s - stamps[-1] - (at - edges[-1]) * step
        if abs(late) > _MOST_JITTER * step and at - edges[-1] >= 2 and samples - at >= 2:
            edges.append(at)
            stamps.append(start.stamp_s)
        else:
            jitter = max(jitter, abs(late))
    if not even:
        whole.warnings.append(
            f"its segments give {len(begins)} start times; they are taken to follow each other "
            "without a gap"
        )
        edges, stamps = [0], [begins[0].stamp_s]
    elif jitter > 0.5 * step:
        whole.warnings.append(
            f"the start times of its segments are up to {jitter:.3g} s off its sampling; where "
            "they are, the samples are taken to follow each other"
        )
    parts = []
    for k, (a, stamp) in enumerate(zip(edges, stamps, strict=True)):
        b = edges[k + 1] if k + 1 < len(edges) else samples
        columns = tuple(replace(column, stamp=stamp) for column in whole.columns)
        warnings = whole.warnings if k == 0 else []
        parts.append(replace(
            whole, columns=columns, warnings=warnings, load=_cut(whole, a, b),
            where=_shifted(whole, a), segment=k + 1 if len(edges) > 1 else 0,
        ))  # fmt: skip
    return parts


def _cut(whole: Recording, a: int, b: int) -> Callable[[Sequence[int]], list[FloatArray]]:
    return lambda columns: [values[a:b] for values in whole.load(columns)]


def _shifted(whole: Recording, a: int) -> Callable[[int], str]:
    return lambda sample: whole.where(a + sample)


class _PatientFile(io.BytesIO):
    """Bytes that can be read for as long as their number justifies."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self.length = len(data)
        megabytes = len(data) * 1e-6
        patience = _PATIENCE_S + _FIRST_MB_S * megabytes + _MORE_MB_S * max(0.0, megabytes - 1)
        self.until = time.monotonic() + patience

    def _check(self) -> None:
        if time.monotonic() > self.until:
            raise TimeoutError("reading it takes far longer than its size explains")

    def read(self, size: int | None = -1, /) -> bytes:
        self._check()
        return super().read(size)

    def readinto(self, buffer: Any, /) -> int:
        self._check()
        return super().readinto(buffer)


@contextmanager
def _guarded(path: Path) -> Iterator[list[str]]:
    """Turn whatever nptdms raises into one error, and what it logs into a list."""
    from nptdms.log import log_manager

    complaints: list[str] = []
    console, level = log_manager.console_handler, log_manager.console_handler.level
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: complaints.append(record.getMessage())  # type: ignore[method-assign]
    logger = logging.getLogger("nptdms")
    logger.addHandler(handler)
    console.setLevel(logging.CRITICAL + 1)
    try:
        with python_warnings.catch_warnings(), np.errstate(all="ignore"):
            python_warnings.simplefilter("ignore")
            yield complaints
    except InputError:
        raise
    except (Exception, MemoryError) as failure:
        raise InputError(
            CODE,
            f"{path}: cannot be read as a TDMS file",
            cause=f"it is damaged or cut off ({str(failure)[:200] or type(failure).__name__})",
            remedy="copy it again from the computer that recorded it",
        ) from failure
    finally:
        console.setLevel(level)
        logger.removeHandler(handler)


def _channels(path: Path, file: _PatientFile) -> tuple[list[Any], list[str]]:
    """Those with numbers in them, and the names of those that are for numbers and have none."""
    from nptdms import TdmsFile

    channels: list[Any] = []
    without = list[str]()
    for group in TdmsFile.open(file).groups():
        for channel in group.channels():
            if len(channel) > file.length:
                raise InputError(
                    CODE,
                    f"{path}: channel {channel.name[:60]!r} claims {len(channel)} samples, "
                    f"more than the {file.length} bytes of the file can hold",
                    cause="a damaged header",
                )
            _refuse_endless_scaling(path, channel)
            if channel.dtype is not None and channel.dtype.kind in "fiuM":
                if len(channel):
                    channels.append(channel)
                else:
                    without.append(repr(channel.name[:60]))
            if len(channels) > _MOST_CHANNELS:
                raise InputError(CODE, f"{path}: has more than {_MOST_CHANNELS} channels")
    return channels, without


def _refuse_endless_scaling(path: Path, channel: Any) -> None:
    for key, value in channel.properties.items():
        counts = key.startswith("NI_") and key.endswith(("_Size", "Number_Of_Scales"))
        if counts and not 0 <= int(value) <= _MOST_SCALES:
            raise InputError(
                CODE,
                f"{path}: channel {channel.name[:60]!r} has {key} = {value}",
                cause="a damaged header",
            )


def _is_time(channel: Any) -> bool:
    return channel.dtype.kind == "M" or is_time(channel.name)


def _said(path: Path, channels: list[Any]) -> Said | None:
    """The settings of an exported sweep, which stand with each of its channels."""
    given = {key: plain(value) for key, value in channels[0].properties.items()}
    return said_in(path, given) if given.get("schema") == MARK else None


def _column(path: Path, channel: Any, times: dict[str, int], said: Said | None) -> Column:
    """A channel with the waveform properties that place it in time."""
    group = channel.group_name
    own_time = _is_time(channel)
    properties = channel.properties
    step: float | None = _property(path, channel, "wf_increment")
    return Column(
        name=channel.name,
        group=group,
        is_time=own_time,
        time_column=None if own_time else times.get(group),
        step_s=step,
        first_s=_property(path, channel, "wf_start_offset") or 0.0,
        stamp=said.start_time if said else _stamp(properties.get("wf_start_time")),
    )


def _property(path: Path, channel: Any, key: str) -> float | None:
    value: Any = channel.properties.get(key)
    if value is None:
        return None
    if isinstance(value, int | float | np.number) and abs(float(value)) < 1e12:  # never NaN
        return float(value)
    raise InputError(
        CODE,
        f"{path}: {key} of channel {channel.name[:60]!r} is {str(value)[:40]!r}",
        cause="a damaged header",
    )


def _stamp(value: Any) -> float | None:
    """``wf_start_time``, which is UTC, as seconds since 1970; None where it is not set."""
    if not isinstance(value, np.datetime64) or np.isnat(value):
        return None
    seconds = float(_since_1970(value))
    return seconds if seconds > 0 else None


def _since_1970(stamps: Any) -> Any:
    """Seconds since 1970 of ``datetime64`` values, rounded once."""
    whole = stamps.astype("datetime64[s]")
    return whole.astype(np.int64) + (stamps - whole) / np.timedelta64(1, "s")


def _load(path: Path, channels: list[Any], columns: Sequence[int]) -> list[FloatArray]:
    arrays = []
    with _guarded(path):
        for column in columns:
            values = np.asarray(channels[column][:])
            if values.dtype.kind == "M":
                values = _since_1970(values)
            arrays.append(np.ascontiguousarray(values, dtype=np.float64))
    return arrays


def _told(complaints: list[str]) -> list[str]:
    """What nptdms complained of, in the words of this program, once each."""
    told = []
    for text in complaints:
        if "less data than expected" in text or "not a multiple" in text or "incomplete" in text:
            text = "the file was cut off: its last part is shorter than announced"
        told.append(text if len(text) < 200 else text[:200])
    return list(dict.fromkeys(told))[:5]
