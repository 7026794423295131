"""Stretches of a sampled signal as they were some time before, straight between samples.

Compiled; imported only when a stage acts.
"""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, nogil=True)
def shifted_each(begins, time, x, late):
    """x (n,) of ``late`` seconds before; a stretch goes on at either end as it is there."""
    out = np.empty(x.size)
    for k in range(begins.size):
        a = begins[k]
        b = begins[k + 1] if k + 1 < begins.size else x.size
        j = a
        for i in range(a, b):
            at = time[i] - late
            while j + 1 < b and time[j + 1] <= at:
                j += 1
            if at <= time[a]:
                out[i] = x[a]
            elif j + 1 == b:
                out[i] = x[j]
            else:
                out[i] = x[j] + (x[j + 1] - x[j]) / (time[j + 1] - time[j]) * (at - time[j])
    return out
