"""Thresholds that all widen by the same share of themselves while a drive goes fast.

Sliders whose thresholds widen by the same volts move as one drive behind a backlash
(`piezo_rig.chain.backlash`). Those that widen by a share of themselves (M. Al Janaideh, S. Rakheja
and C.-Y. Su, Mechatronics 19 (2009) 656) do not: each is followed by itself, beside the
same slider at rest, and what makes the difference is added to what springs and sliders do.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain.branches import Branches, sliders
from piezo_rig.chain.stage import Wider

FloatArray = NDArray[np.float64]


def wider_um(
    branches: Branches, begins: NDArray[np.int64], drive_v: FloatArray, wider: Wider
) -> FloatArray:
    """What sliders add to the displacement by widening, um, shape (n,).

    Parameters
    ----------
    begins : shape (k,), where stretches begin that know nothing of each other
    wider : by how much every threshold is wider
    """
    return _added(begins, np.ascontiguousarray(drive_v), *sliders(branches), *wider)


def each_wider_v(
    thresholds: FloatArray, begins: NDArray[np.int64], drive_v: FloatArray, wider: Wider
) -> FloatArray:
    """How much further the play operators (m,) are for widening, V, shape (m, n)."""
    one, drive = np.ones(1), np.ascontiguousarray(drive_v)
    rows = [_added(begins, drive, np.array([r]), one, *wider) for r in thresholds]
    return np.array(rows).reshape(thresholds.size, drive.size)


@numba.njit(cache=True, nogil=True)
def _added(begins, drive, thresholds, weights, share, still):
    """Weighted sum of how far wider play operators are off those that stay as they are."""
    m = thresholds.size
    plain, wide, out = np.empty(m), np.empty(m), np.empty(drive.size)
    for k in range(begins.size):
        a = begins[k]
        b = begins[k + 1] if k + 1 < begins.size else drive.size
        for j in range(m):
            plain[j] = wide[j] = drive[a]
        for i in range(a, b):
            v, times, total = drive[i], 1.0 + share[i], 0.0
            if not np.isnan(still[i]):
                for j in range(m):
                    r = thresholds[j]
                    wide[j] = min(max(wide[j], still[i] - r), still[i] + r)
            for j in range(m):
                r = thresholds[j]
                plain[j] = min(max(plain[j], v - r), v + r)
                r *= times
                wide[j] = min(max(wide[j], v - r), v + r)
            for j in range(m):
                total += weights[j] * (wide[j] - plain[j])
            out[i] = total
    return out
