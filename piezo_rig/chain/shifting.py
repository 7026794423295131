"""Stretches of a sampled signal as they were some time before, straight between samples.

Compiled; imported only when a stage acts.
"""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, nogil=True)
def shifted_each(begins, time, rows, late):
    """Rows (k, n) of ``late`` seconds before; a stretch goes on at either end as it is there."""
    n = time.size
    before = np.empty(n, np.int64)  # the sample before, and how far behind it of the step
    share = np.empty(n)
    for k in range(begins.size):
        a = begins[k]
        b = begins[k + 1] if k + 1 < begins.size else n
        j = a
        for i in range(a, b):
            at = time[i] - late
            while j + 1 < b and time[j + 1] <= at:
                j += 1
            before[i] = j
            share[i] = 0.0
            if at > time[a] and j + 1 < b:
                share[i] = (at - time[j]) / (time[j + 1] - time[j])
    out = np.empty(rows.shape)
    for m in range(rows.shape[0]):
        for i in range(n):
            j = before[i]
            out[m, i] = rows[m, j]
            if share[i] > 0.0:
                out[m, i] += share[i] * (rows[m, j + 1] - rows[m, j])
    return out
