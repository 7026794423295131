"""Compiled loop of a drive whose speed is limited. Imported only where it is needed."""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True)
def met(out, before, drive, most):
    """Where it is a step later, if the drive went straight from ``before`` to ``drive``.

    ``most`` : how far it can go in that step. It may meet the drive on the way, as behind
    every turning point: from there it goes along, or the other way as fast as it can.
    """
    gap, moved = before - out, drive - before
    way = 1.0 if gap > 0.0 or (gap == 0.0 and moved > 0.0) else -1.0
    gap, moved = gap * way, moved * way
    closing = most - moved
    if closing < gap:
        return out + way * most
    if moved >= -most:
        return drive
    return out + way * most * (2.0 * gap / closing - 1.0)


@numba.njit(cache=True)
def followed(time, drive, limit):
    """A drive (n,) that moves towards another one by no more than ``limit`` per second."""
    out = np.empty(drive.size)
    out[0] = drive[0]
    for i in range(1, drive.size):
        most = limit * max(time[i] - time[i - 1], 0.0)
        out[i] = met(out[i - 1], drive[i - 1], drive[i], most)
    return out
