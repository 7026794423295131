"""Where a TDMS file begins again in time: the start times that its segments give.

nptdms keeps the last value of a property and forgets those of earlier segments, so the lead-ins
are walked here. A segment begins with 28 bytes: a mark, flags, a version, the distance to the
next segment and to the raw data; a time stamp is a fraction in 2^-64 s and seconds since 1904.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

_LEAD_IN = struct.Struct("<4sIIQQ")
_STAMP = b"wf_start_time" + struct.pack("<I", 0x44)
_VALUE = struct.Struct("<Qq")
_1904_S = 2_082_844_800  # to 1970
_BIG_ENDIAN = 1 << 6
_UNKNOWN = (1 << 64) - 1
MOST = 200


@dataclass(frozen=True)
class Start:
    """A segment whose start time is not the one before it.

    Attributes
    ----------
    position : its first byte in the file
    stamp_s : seconds since 1970
    """

    position: int
    stamp_s: float


def starts(data: bytes) -> list[Start]:
    """Every segment with a new start time, in order; one or none for most files."""
    found: list[Start] = []
    position = 0
    while position + _LEAD_IN.size <= len(data) and len(found) <= MOST:
        mark, flags, _, length, raw = _LEAD_IN.unpack_from(data, position)
        if mark != b"TDSm" or flags & _BIG_ENDIAN:
            break
        begin = position + _LEAD_IN.size
        at = data.find(_STAMP, begin, min(begin + raw, len(data)))
        if at >= 0 and at + len(_STAMP) + _VALUE.size <= len(data):
            fraction, seconds = _VALUE.unpack_from(data, at + len(_STAMP))
            stamp = seconds - _1904_S + fraction * 2.0**-64
            if stamp > 0 and (not found or stamp != found[-1].stamp_s):
                found.append(Start(position, stamp))
        if length == 0 or length > len(data):
            break
        position = begin + length
    return found


def missing_bytes(data: bytes) -> int:
    """Bytes that the last segment says it has, beyond the end of the file; 0 of a whole one.

    A segment that was still being written does not say how long it is.
    """
    position = 0
    while position + _LEAD_IN.size <= len(data):
        mark, flags, _, length, _ = _LEAD_IN.unpack_from(data, position)
        if mark != b"TDSm" or flags & _BIG_ENDIAN or length == _UNKNOWN:
            return 0
        position += _LEAD_IN.size + length
    return max(position - len(data), 0)
