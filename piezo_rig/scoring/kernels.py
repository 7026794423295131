"""Compiled loops of the oracle: play operators, and noise made and taken out exactly."""

from __future__ import annotations

import math

import numba
import numpy as np


@numba.njit(cache=True)
def play(drive, thresholds):
    """Play operators from a zero state at zero drive, shape (n, m)."""
    n, m = drive.size, thresholds.size
    out = np.empty((n, m))
    state = np.zeros(m)
    for i in range(n):
        v = drive[i]
        for j in range(m):
            s = min(max(state[j], v - thresholds[j]), v + thresholds[j])
            state[j] = s
            out[i, j] = s
    return out


@numba.njit(cache=True)
def innovations(columns, decays, variances, white):
    """Columns (n, m) whitened exactly for noise that is a sum of AR(1) processes plus white.

    Kalman's filter with the stationary start: row i becomes (column - its prediction from the
    rows before) / standard deviation of that prediction's error.
    """
    n, m = columns.shape
    k = decays.size
    out = np.empty((n, m))
    p = np.zeros((k, k))
    for a in range(k):
        p[a, a] = variances[a]
    state = np.zeros((k, m))
    gain = np.zeros(k)
    for i in range(n):
        total = white
        for a in range(k):
            row = 0.0
            for b in range(k):
                row += p[a, b]
            gain[a] = row
            total += row
        scale = 1.0 / math.sqrt(total)
        for a in range(k):
            gain[a] /= total
        for c in range(m):
            seen = columns[i, c]
            for a in range(k):
                seen -= state[a, c]
            out[i, c] = seen * scale
            for a in range(k):
                state[a, c] = decays[a] * (state[a, c] + gain[a] * seen)
        for a in range(k):
            for b in range(a, k):
                q = decays[a] * decays[b] * (p[a, b] - gain[a] * gain[b] * total)
                if a == b:
                    q += variances[a] * (1.0 - decays[a] * decays[a])
                p[a, b] = q
                p[b, a] = q
    return out


@numba.njit(cache=True)
def autoregressive(white, first, decay, sigma):
    """AR(1) noise (n,) of standard deviation sigma from white (n,) and a first value."""
    out = np.empty(white.size)
    x = sigma * first
    step = sigma * math.sqrt(1.0 - decay * decay)
    for i in range(white.size):
        out[i] = x
        x = decay * x + step * white[i]
    return out
