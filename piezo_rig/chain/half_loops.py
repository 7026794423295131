"""Half loops: the stretches of a drive between its turning points.

A recorded drive carries noise, and every wiggle of it is a reversal. The
memory of the elements takes those as they come (they are real volts), but the
input range and the local extremum of the thesis mean the drive that was
played. So half loops are counted with a dead band that is estimated from the
drive itself and vanishes for a clean one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BLOCKS, BLOCK = 16, 400  # samples looked at for the dead band
REACH = 10.0  # dead band in standard deviations: two extremes of a long hold
FEWEST = 64  # samples, of which corners are no large part: fewer do not say what is noise
LARGEST = 0.05  # of the drive's range
MANY, FEWER = 20, 2.0  # reversals of a random walk; of those left beyond twice the dead band
SMALL = 5e-4  # of the range of the drive: ringing or rounding, and no half loop


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

    def only(self, i: int) -> HalfLoops:
        """One half loop by itself."""
        return HalfLoops(*(getattr(self, f.name)[i : i + 1] for f in fields(self)))

    def first(self, count: int) -> HalfLoops:
        """Those at the beginning."""
        return HalfLoops(*(getattr(self, f.name)[:count] for f in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[HalfLoops], begins: Sequence[int]) -> HalfLoops:
        """Those of several stretches of one array, which begin at these samples."""
        late = [replace(p, start=p.start + a, stop=p.stop + a)
                for p, a in zip(parts, begins, strict=True)]  # fmt: skip
        return cls(*(np.concatenate([getattr(p, f.name) for p in late]) for f in fields(cls)))


def dead_band(drive_v: FloatArray) -> float:
    """Reversals smaller than this are noise, volts; about 0 for a clean drive."""
    band = REACH * noise(drive_v)
    # what is larger than that is a waveform of few samples, not noise on one
    if band == 0.0 or band >= LARGEST * float(np.ptp(drive_v)):
        return 0.0
    return 0.0 if _of_every_size(drive_v, band) else band


def _of_every_size(drive_v: FloatArray, band: float) -> bool:
    """Whether reversals only just beyond a dead band are as frequent as in a random walk.

    From sample to sample a random walk looks like noise. But of its reversals three in four are
    gone when the band is twice as wide, where those of a noisy waveform are all still there.
    """
    from piezo_rig.chain.kernels import turning_points

    drive = np.ascontiguousarray(drive_v, dtype=float)
    inside, beyond = (turning_points(drive, times * band).size for times in (1.0, 2.0))
    return bool(inside > MANY and inside > FEWER * beyond)


def least_reversal(drive_v: FloatArray) -> float:
    """Reversals smaller than this are no half loops, volts: noise, ringing, rounding."""
    return max(dead_band(drive_v), SMALL * float(np.ptp(drive_v))) if drive_v.size else 0.0


def noise(drive_v: FloatArray) -> float:
    """Standard deviation of white noise on a waveform; 0 where there is none to be seen.

    Third differences of white noise change sign from sample to sample
    (their correlation is -0.75), those of a sampled waveform do not. The
    median makes corners and jumps count for nothing.
    """
    n = drive_v.size
    if n < FEWEST:
        return 0.0
    if n <= BLOCKS * BLOCK:
        pieces = drive_v[None, :]
    else:
        starts = np.linspace(0, n - BLOCK, BLOCKS).astype(int)
        pieces = np.stack([drive_v[i : i + BLOCK] for i in starts])
    first = pieces[:, 1:] - pieces[:, :-1]
    second = first[:, 1:] - first[:, :-1]
    third = second[:, 1:] - second[:, :-1]
    sizes = np.abs(third).ravel()
    middle = float(np.partition(sizes, sizes.size // 2)[sizes.size // 2])
    sigma = middle / (0.6745 * np.sqrt(20.0))
    if sigma == 0.0:
        return 0.0
    # corners and jumps must not decide what is smooth
    small = np.minimum(np.maximum(third, -5.0 * middle), 5.0 * middle)
    products = float(np.vdot(small[:, 1:], small[:, :-1]))
    power = float(np.vdot(small, small))
    if products >= -0.3 * power:
        return 0.0
    return sigma


def half_loops(drive_v: FloatArray, band: float | None = None) -> HalfLoops:
    """Half loops of a drive, shape (n,), in volts; ``band`` replaces `least_reversal`."""
    from piezo_rig.chain.kernels import turning_points

    drive = np.ascontiguousarray(drive_v, dtype=float)
    start = turning_points(drive, least_reversal(drive) if band is None else band)
    stop = np.append(start[1:], drive.size - 1)
    change = drive[stop] - drive[start]
    range_v = np.abs(np.concatenate([change[:1], change[:-1]]))
    direction = np.where(change < 0, -1.0, 1.0)
    return HalfLoops(start, stop, range_v, drive[start], direction)
