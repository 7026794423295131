"""Half loops: the stretches of a drive between its turning points.

A recorded drive carries noise, and every wiggle of it is a reversal. The
memory of the elements takes those as they come (they are real volts), but the
input range and the local extremum of the thesis mean the drive that was
played. So half loops are counted with a dead band that is estimated from the
drive itself and vanishes for a clean one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BLOCKS, BLOCK = 16, 400  # samples looked at for the dead band
REACH = 10.0  # dead band in standard deviations: two extremes of a long hold
LARGEST = 0.05  # of the drive's range


@dataclass(frozen=True, eq=False)
class HalfLoops:
    """The half loops of one drive, in order.

    Attributes
    ----------
    start : shape (m,), first sample (its turning point; 0 for the first)
    stop : shape (m,), last sample (the next turning point)
    range_v : shape (m,), drive change of the half loop *before*; of the first, its own
    extremum_v : shape (m,), drive at the turning point where it begins
    direction : shape (m,), +1 rising, -1 falling
    """

    start: NDArray[np.int64]
    stop: NDArray[np.int64]
    range_v: FloatArray
    extremum_v: FloatArray
    direction: FloatArray

    def __len__(self) -> int:
        return int(self.start.size)


def dead_band(drive_v: FloatArray) -> float:
    """Reversals smaller than this are noise, volts; about 0 for a clean drive.

    Third differences of white noise change sign from sample to sample
    (their correlation is -0.75), those of a sampled waveform do not. The
    median makes corners and jumps count for nothing.
    """
    n = drive_v.size
    if n < 16:
        return 0.0
    if n <= BLOCKS * BLOCK:
        pieces = [drive_v]
    else:
        starts = np.linspace(0, n - BLOCK, BLOCKS).astype(int)
        pieces = [drive_v[i : i + BLOCK] for i in starts]
    third = [np.diff(p, 3) for p in pieces]
    sizes = np.abs(np.concatenate(third))
    sigma = float(np.median(sizes)) / (0.6745 * np.sqrt(20.0))
    if sigma == 0.0:
        return 0.0
    # corners and jumps must not decide what is smooth
    cut = 5.0 * float(np.median(sizes))
    small = [np.clip(d, -cut, cut) for d in third]
    products = sum(float(np.dot(d[1:], d[:-1])) for d in small)
    power = sum(float(np.dot(d, d)) for d in small)
    if products >= -0.3 * power:
        return 0.0
    # what is larger than that is a waveform of few samples, not noise on one
    return REACH * sigma if REACH * sigma < LARGEST * float(np.ptp(drive_v)) else 0.0


def half_loops(drive_v: FloatArray, band: float | None = None) -> HalfLoops:
    """Half loops of a drive, shape (n,), in volts; ``band`` replaces the estimated dead band."""
    from piezo_rig.chain.kernels import turning_points

    drive = np.ascontiguousarray(drive_v, dtype=float)
    start = turning_points(drive, dead_band(drive) if band is None else band)
    stop = np.append(start[1:], drive.size - 1)
    change = drive[stop] - drive[start]
    range_v = np.abs(np.concatenate([change[:1], change[:-1]]))
    direction = np.where(change < 0, -1.0, 1.0)
    return HalfLoops(start, stop, range_v, drive[start], direction)
