"""Backlash of a width that changes with time: a play operator with one threshold per sample.

Sliders whose thresholds all widen by w(t) move as if the drive reached them through it: play
operators with thresholds r and w, one behind the other, are one with r + w (M. Brokate and
J. Sprekels, Hysteresis and Phase Transitions, 1996, section 2.3, for constant w).
"""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, nogil=True)
def behind(drive, width):
    """The drive (n,) behind a backlash of ``width`` (n,) volts to either side."""
    out = np.empty(drive.size)
    y = drive[0] if drive.size else 0.0
    for i in range(drive.size):
        y = min(max(y, drive[i] - width[i]), drive[i] + width[i])
        out[i] = y
    return out


@numba.njit(cache=True, nogil=True)
def behind_each(begins, drive, width):
    """`behind` of stretches that begin at these samples."""
    out = np.empty(drive.size)
    for k in range(begins.size):
        a = begins[k]
        b = begins[k + 1] if k + 1 < begins.size else drive.size
        out[a:b] = behind(drive[a:b], width[a:b])
    return out
