"""Reversals of a drive that its target does not make, and of which nobody knows what they count.

Creep that goes on after a stop is taken back by some hundredths of a volt while the target stands
or moves on slowly. Whether so small a reversal ends a half loop, and the laws of the first spring
take another range from then on, no model knows: `chain.half_loops.SMALL` is an assumption. So a
drive waits rather than go back by little more than that
(docs/decisions/0015-how-a-model-is-inverted.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain.half_loops import SMALL, half_loops

FloatArray = NDArray[np.float64]
DOUBTFUL = 2.0  # times the least reversal that counts, up to which it is not known to count
KEPT = 0.9  # of that least reversal: how far the drive may go back all the same
OWN = 0.1  # share of a reversal that the target makes, above which it is the target's


@dataclass(frozen=True, eq=False)
class Waits:
    """Where a drive shall stay at every sample, shapes (n,), V; infinite where it may go.

    ``count`` of reversals that are waited out, the largest of which was ``largest_v``
    """

    low_v: FloatArray
    high_v: FloatArray
    count: int = 0
    largest_v: float = 0.0

    @classmethod
    def none(cls, samples: int) -> Waits:
        return cls(np.full(samples, -np.inf), np.full(samples, np.inf))

    def joined(self, other: Waits) -> Waits:
        """Both kept to."""
        return Waits(
            np.maximum(self.low_v, other.low_v), np.minimum(self.high_v, other.high_v),
            self.count + other.count, max(self.largest_v, other.largest_v),
        )


def doubtful(drive_v: FloatArray, wanted_um: FloatArray) -> Waits:
    """Where a drive (n,) goes back a little although its target (n,) does not.

    From the turning point until the drive has come back to it.
    """
    least_v = SMALL * float(np.ptp(drive_v))
    loops = half_loops(drive_v, least_v)
    um_per_v = float(np.ptp(wanted_um)) / max(float(np.ptp(drive_v)), 1e-12)
    waits = Waits.none(drive_v.size)
    for k in range(1, len(loops) - 1):
        start, stop, way = loops.start[k], loops.stop[k], loops.direction[k]
        turn_v, back_v = drive_v[start], abs(drive_v[stop] - drive_v[start])
        if back_v > DOUBTFUL * least_v:
            continue
        after = np.flatnonzero((drive_v[stop:] - turn_v) * way <= 0.0)
        end = stop + int(after[0]) if after.size else drive_v.size - 1
        moved = wanted_um[start : end + 1]
        turned = np.max(np.maximum.accumulate(-way * moved) + way * moved)
        if turned > OWN * um_per_v * back_v:
            continue
        here, edge = slice(start, end + 1), turn_v + way * KEPT * least_v
        if way < 0.0:
            waits.low_v[here] = edge
        else:
            waits.high_v[here] = edge
        waits = Waits(waits.low_v, waits.high_v, waits.count + 1,
                      max(waits.largest_v, float(back_v)))  # fmt: skip
    return waits
