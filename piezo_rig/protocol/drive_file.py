"""A drive that a protocol plays from a file: a CSV with ``time_s,drive_v``, as `compensate` writes.

A run keeps the files of its protocol, packed, so that it can be resumed and replayed by itself.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezo_rig.csv_table import LARGEST, parse_table
from piezo_rig.errors import InputError

FloatArray = NDArray[np.float64]
COLUMNS = ("time_s", "drive_v")
STORED_BYTES = 4_500_000  # of one run; a text in a run file ends at 5 MB


@dataclass(frozen=True, eq=False)
class Played:
    """The rows of a file, straight lines between them; its first row is the segment's beginning."""

    time_s: FloatArray
    drive_v: FloatArray

    @property
    def start_v(self) -> float:
        return float(self.drive_v[0])

    @property
    def end_v(self) -> float:
        return float(self.drive_v[-1])

    def count(self, rate: float) -> int:
        return round(float(self.time_s[-1] - self.time_s[0]) * rate)

    def samples(self, rate: float) -> FloatArray:
        time = self.time_s - self.time_s[0]
        return np.interp(np.arange(self.count(rate)) / rate, time, self.drive_v)


def played(text: str, name: str, largest_v: float) -> Played:
    """The segment of a file's text.

    Raises
    ------
    InputError : no such table, too few rows, time that does not grow, volts that cannot be
    """
    time, drive = parse_table(text, COLUMNS, name)
    if time.size < 2:
        raise _wrong(name, f"{time.size} rows", "give at least two")
    for values, word, most in ((time, "time_s", 1e9), (drive, "drive_v", largest_v)):
        bad = np.flatnonzero(~(np.abs(values) <= most))
        if bad.size:
            raise _wrong(name, f"{word} is {values[bad[0]]:g} in row {bad[0] + 1}",
                         f"{word} is a number, at most {most:g}")
    late = np.flatnonzero(~(np.diff(time) > 0.0))
    if late.size:
        k = int(late[0]) + 1
        raise _wrong(name, f"time_s goes from {time[k - 1]:.9g} to {time[k]:.9g} s in row {k + 1}",
                     "let time grow from row to row")
    return Played(time, drive)


def digest(text: str) -> str:
    """SHA-256 of a file's text."""
    return hashlib.sha256(text.encode()).hexdigest()


def pack(files: dict[str, str]) -> str:
    """Files (path -> text) as one text for a run; empty for none."""
    packed = {p: base64.b85encode(zlib.compress(t.encode(), 9)).decode() for p, t in files.items()}
    return json.dumps(packed, sort_keys=True) if files else ""


def unpack(text: str, run: str) -> dict[str, str]:
    """What `pack` has packed.

    Raises
    ------
    InputError : it is damaged
    """
    try:
        packed: Any = json.loads(text) if text else {}
        return {path: _unzipped(data) for path, data in packed.items()}
    except (ValueError, AttributeError, TypeError, zlib.error, binascii.Error, RecursionError):
        raise InputError("run-damaged", f"{run}: the files of its protocol cannot be read",
                         "the run is damaged", "check it with 'piezo-rig verify'") from None


def _unzipped(data: str) -> str:
    stream = zlib.decompressobj()
    text = stream.decompress(base64.b85decode(data), LARGEST).decode()
    if not stream.eof:
        raise ValueError
    return text


def _wrong(name: str, what: str, remedy: str) -> InputError:
    return InputError("drive-file", f"{name}: {what}", "not a file that can be played", remedy)
