"""The wire transcript of a run: every byte that went over a line, in order.

A record is time (double), instrument, direction (0 out, 1 in, 2 event), length, data. Which
instrument a number stands for is the order of ``INSTRUMENTS``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from piezo_rig.errors import InputError
from piezo_rig.run_file.writer import DIRECTIONS, WIRE_HEAD

INSTRUMENTS = ("waveform_dac", "digitizer", "amplifier", "interferometer")


@dataclass(frozen=True)
class WireRecord:
    """One transfer: ``direction`` is ``out``, ``in`` or ``event``; time on the bench's clock."""

    time_s: float
    instrument: str
    direction: str
    data: bytes


def records(data: bytes) -> Iterator[WireRecord]:
    """The records of a transcript.

    Raises
    ------
    InputError : (transcript) it is cut off, or is no transcript
    """
    at = 0
    while at < len(data):
        if at + WIRE_HEAD.size > len(data):
            raise _damaged(f"ends inside a record at byte {at}")
        time_s, instrument, direction, length = WIRE_HEAD.unpack_from(data, at)
        begin, at = at, at + WIRE_HEAD.size
        if not math.isfinite(time_s) or time_s < 0 or instrument >= len(INSTRUMENTS) or (
            direction >= len(DIRECTIONS)
        ):
            raise _damaged(f"holds no record at byte {begin}")
        if at + length > len(data):
            raise _damaged(f"ends inside the record at byte {begin}")
        yield WireRecord(
            time_s, INSTRUMENTS[instrument], DIRECTIONS[direction], data[at : at + length]
        )
        at += length


def _damaged(what: str) -> InputError:
    return InputError(
        "transcript", f"the wire transcript {what}", "the file is damaged",
        "take the run from the backup",
    )
