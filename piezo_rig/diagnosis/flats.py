"""Where a sensor ends: recordings of one drive are alike there, however unlike they are around.

An actuator that ages goes further from one recording to the next, but for the flat tops that a
sensor leaves. What they differ by falls to nothing there, and comes back: edges that look like
jumps, and like lost samples.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezo_rig.diagnosis.groups import Group
from piezo_rig.diagnosis.masks import runs

FloatArray = NDArray[np.float64]
NEAR = 0.005  # of the travel: so near to the end they say what recordings differ by there
MEDIAN = 0.674  # of the size of a normal number, in standard deviations
WITHIN = 12.0  # standard deviations below the highest of all
WIDE = 4.0  # so many times further would it have gone, had it gone on
EDGE = 2  # samples to either side that may be half flat
BESIDE = 16  # samples to either side that say where it would have been


def standing(group: Group) -> NDArray[np.bool_]:
    """Samples (n,) at which the displacement stands at its end while the drive goes on."""
    rows = group.measured_um
    mean, out = rows.mean(axis=0), np.zeros(rows.shape[1], bool)
    travel = float(np.ptp(mean))
    um_per_v = travel / max(float(np.ptp(group.drive_v)), 1e-300)
    for sign in (1.0, -1.0) if len(rows) > 1 else ():
        end = float((sign * mean).max())
        high = rows[:, sign * mean > end - NEAR * travel]
        off = np.abs(high - high.mean(axis=0))
        spread = float(np.median(off)) / MEDIAN * np.sqrt(len(rows) / (len(rows) - 1.0))
        deep = WITHIN * spread
        for a, b in runs(sign * mean > end - deep):
            if um_per_v * float(np.ptp(group.drive_v[a:b])) > WIDE * deep:
                out[max(a - EDGE, 0) : b + EDGE] = True
    return out


def bridged(own: FloatArray, flat: NDArray[np.bool_]) -> FloatArray:
    """What a recording has of its own (n,), with straight lines over where it stands."""
    out = own.copy()
    for a, b in runs(flat):
        before, after = own[max(a - BESIDE, 0) : a], own[b : b + BESIDE]
        ends = [float(part.mean()) for part in (before, after) if part.size]
        if ends:
            out[a:b] = np.linspace(ends[0], ends[-1], b - a)
    return out
