"""A sampled signal seen through one mechanical mode, exact for signals straight between samples.

y'' + 2 z w y' + w^2 y = w^2 x, w in rad/s, 0 < z < 1: behind a ramp by ``behind`` = 2 z / w. Where
what damps it moves along with x, y'' + 2 z w (y' - x') + w^2 y = w^2 x, it is not behind (0).
Samples need not be evenly spaced.
Compiled; imported only when a stage acts.
"""

from __future__ import annotations

import math

import numba
import numpy as np

SAME_STEP = 1e-9  # relative: times are rounded, and no exponential is taken anew for that


@numba.njit(cache=True, nogil=True)
def rung(time, rows, omega, damping, behind):
    """Rows (k, n) through the mode, shape (k, n); each begins settled at its first sample."""
    k, n = rows.shape
    x = np.ascontiguousarray(rows.T)
    out = np.empty((n, k))
    # how far the mode is off what it would follow, and the rate of that
    off = np.zeros(k)
    rate = np.zeros(k)
    slope = np.zeros(k)
    ringing = omega * math.sqrt(1.0 - damping * damping)
    known = 0.0
    c = s = 0.0
    for m in range(k):
        out[0, m] = x[0, m]
    for i in range(1, n):
        step = time[i] - time[i - 1]
        if step <= 0.0:
            for m in range(k):
                out[i, m] = out[i - 1, m]
            continue
        if abs(step - known) > SAME_STEP * known:
            known = step
            fade = math.exp(-damping * omega * step)
            c = fade * math.cos(ringing * step)
            s = fade * math.sin(ringing * step) / ringing
        for m in range(k):
            new = (x[i, m] - x[i - 1, m]) / step
            # the straight line that is followed lies behind x by its slope
            e = off[m] + behind * (new - slope[m])
            v = rate[m] - (new - slope[m])
            slope[m] = new
            off[m] = c * e + s * (v + damping * omega * e)
            rate[m] = c * v - s * (omega * omega * e + damping * omega * v)
            out[i, m] = x[i, m] - behind * new + off[m]
    return np.ascontiguousarray(out.T)


@numba.njit(cache=True, nogil=True)
def rung_each(begins, time, rows, omega, damping, behind):
    """`rung` of stretches that begin at these samples."""
    out = np.empty(rows.shape)
    for k in range(begins.size):
        a = begins[k]
        b = begins[k + 1] if k + 1 < begins.size else time.size
        out[:, a:b] = rung(time[a:b], rows[:, a:b], omega, damping, behind)
    return out
