"""First-order lags of a sampled signal, exact for signals that are straight between samples.

Samples need not be evenly spaced, and a time constant may be shorter or longer than any step.
Compiled; imported only when a stage acts.
"""

from __future__ import annotations

import math

import numba
import numpy as np

SAME_STEP = 1e-9  # relative: times are rounded, and no exponential is taken anew for that


@numba.njit(cache=True, nogil=True)
def off(time, x, tau):
    """How far a first-order lag behind x is off it, shape (n,); it begins settled.

    At rest it dies away to nothing, so that a power of it shows no rounding of x.
    """
    out = np.zeros(x.size)
    d = 0.0
    known = 0.0
    decay = hold = 0.0
    for n in range(1, x.size):
        step = time[n] - time[n - 1]
        if step <= 0.0:
            d -= x[n] - x[n - 1]
            out[n] = d
            continue
        if abs(step - known) > SAME_STEP * known:
            known = step
            decay = math.exp(-step / tau)
            hold = -math.expm1(-step / tau) * tau / step
        d = decay * d - hold * (x[n] - x[n - 1])
        out[n] = d
    return out


@numba.njit(cache=True, nogil=True)
def off_each(begins, time, x, tau):
    """`off` of stretches that begin at these samples."""
    out = np.empty(x.size)
    for k in range(begins.size):
        a = begins[k]
        b = begins[k + 1] if k + 1 < begins.size else x.size
        out[a:b] = off(time[a:b], x[a:b], tau)
    return out


@numba.njit(cache=True, nogil=True)
def held(x, tau):
    """Behind a lag of ``tau`` samples where every sample is held until the next, at the samples."""
    out = np.empty(x.size)
    share = -math.expm1(-1.0 / tau)
    out[0] = x[0]
    for n in range(1, x.size):
        out[n] = out[n - 1] + share * (x[n - 1] - out[n - 1])
    return out


@numba.njit(cache=True, nogil=True)
def relaxations(time, x, taus, out):
    """Lags of x, each less its value at the first sample, into ``out`` (n, taus.size)."""
    count = taus.size
    q = np.zeros(count)
    decay = np.ones(count)
    known = 0.0
    out[0] = 0.0
    for n in range(1, x.size):
        step = time[n] - time[n - 1]
        if step > 0.0:
            if abs(step - known) > SAME_STEP * known:
                known = step
                for k in range(count):
                    decay[k] = math.exp(-step / taus[k])
            before = x[n - 1] - x[0]
            here = x[n] - x[0]
            slope = (here - before) / step
            for k in range(count):
                slow = slope * taus[k]
                q[k] = here - slow + (q[k] - before + slow) * decay[k]
        for k in range(count):
            out[n, k] = q[k]


@numba.njit(cache=True, nogil=True)
def relaxations_each(begins, time, x, taus, out):
    """`relaxations` of stretches that begin at these samples."""
    for k in range(begins.size):
        a = begins[k]
        b = begins[k + 1] if k + 1 < begins.size else x.size
        relaxations(time[a:b], x[a:b], taus, out[a:b])


@numba.njit(cache=True, nogil=True)
def relaxed_rows(time, rows, taus, weights):
    """Weighted sums of `relaxations` of many signals (k, n) at once, shape (k, n)."""
    k, n = rows.shape
    x = np.ascontiguousarray(rows.T)
    out = np.zeros((n, k))
    q = np.zeros((taus.size, k))
    known = 0.0
    decay = np.zeros(taus.size)
    hold = np.zeros(taus.size)
    for i in range(1, n):
        step = time[i] - time[i - 1]
        if step > 0.0:
            if abs(step - known) > SAME_STEP * known:
                known = step
                for j in range(taus.size):
                    decay[j] = math.exp(-step / taus[j])
                    # weight of the straight piece's begin: see `relaxations`
                    hold[j] = taus[j] / step * (1.0 - decay[j])
            for j in range(taus.size):
                a = decay[j]
                b = 1.0 - hold[j]
                c = hold[j] - a
                for m in range(k):
                    q[j, m] = a * q[j, m] + b * (x[i, m] - x[0, m]) + c * (x[i - 1, m] - x[0, m])
        for j in range(taus.size):
            w = weights[j]
            for m in range(k):
                out[i, m] += w * q[j, m]
    return np.ascontiguousarray(out.T)
