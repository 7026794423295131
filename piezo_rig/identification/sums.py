"""Compiled sums over walked drives: the sufficient statistics of least squares.

On one segment of a walk the displacement, and its derivative by every
parameter, is a constant plus a slope times the drive. So a segment's
contribution to the normal equations needs only its number of samples and the
sums of u, u^2, y and u y (u = drive - drive at its beginning), and the cost of
a Gram matrix grows with the number of segments, not of samples.
"""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, fastmath=True, boundscheck=False)
def segment_sums(v, y, ints, floats, begin):
    """n, sum u, sum u^2, sum y, sum u y of every segment in the samples given, shape (s, 5).

    v and y hold the samples from ``begin`` on.
    """
    count = ints.shape[0]
    out = np.zeros((count, 5))
    for s in range(count):
        a = max(ints[s, 0] - begin, 0)
        b = min(ints[s, 1] - begin, v.size)
        if b <= a:
            continue
        anchor = floats[s, 0]
        drive = v[a:b]
        value = y[a:b]
        su = 0.0
        suu = 0.0
        sy = 0.0
        suy = 0.0
        for k in range(drive.size):
            u = drive[k] - anchor
            su += u
            suu += u * u
            sy += value[k]
            suy += u * value[k]
        out[s, 0] = b - a
        out[s, 1] = su
        out[s, 2] = suu
        out[s, 3] = sy
        out[s, 4] = suy
    return out


@numba.njit(cache=True, boundscheck=False)
def columns(ints, floats, n0, init_c, rest_c, first_break, law, by_law, knots, state):
    """Derivative of the displacement by every parameter where each segment begins.

    Columns: n0 initiation compliances; then, by law, q first-slope parameters, the first break
    and the compliances of the rest, or else the compliances of all later bands; then, with
    knots, the break points of the initiation curve and of the later branch (by law: of the rest).

    Parameters
    ----------
    law : shape (m, q), derivative of every half loop's first slope by the law's parameters
    state : shape (p,), the columns where the walk before ended; changed in place

    Returns
    -------
    begin : shape (s, p)
    active : shape (s,), first column that changes with the drive
    rate : shape (s, max(q, 1)), its derivative by volts; q columns from ``active`` on where
        the first piece of a branch by law is active, one otherwise
    """
    count = ints.shape[0]
    q = law.shape[1]
    p = state.size
    nc = rest_c.size + 1
    later = n0 + q + 1 if by_law else n0 + 1  # column of the first band after the first break
    knot0 = later + nc - 1
    knot_later = knot0 + n0 - 1
    begin = np.empty((count, p))
    active = np.empty(count, np.int64)
    rate = np.zeros((count, max(q, 1)))
    for s in range(count):
        code = ints[s, 2]
        change = floats[s, 1] - floats[s, 0]
        if code < n0:
            if ints[s, 4] != 0 and knots:
                state[knot0 + code - 1] += ints[s, 4] * (init_c[code - 1] - init_c[code])
            for j in range(p):
                begin[s, j] = state[j]
            active[s] = code
            rate[s, 0] = 1.0
            state[code] += change
            continue
        band = code - n0
        slope = floats[s, 2]
        if ints[s, 4] != 0 and (by_law or knots):
            sign = ints[s, 4]
            before = 1.0 / slope if band == 1 else rest_c[band - 2]
            fall = before - rest_c[band - 1]
            if by_law:
                for j in range(q):
                    state[n0 + j] += sign * first_break * fall * law[ints[s, 3], j]
                state[n0 + q] += sign * slope * fall
                if knots and band > 1:
                    state[knot_later + band - 2] += sign * fall
            else:
                state[knot_later + band - 1] += sign * fall
        for j in range(p):
            begin[s, j] = state[j]
        if band == 0 and by_law:
            active[s] = n0
            for j in range(q):
                rate[s, j] = -law[ints[s, 3], j] / (slope * slope)
                state[n0 + j] += rate[s, j] * change
        else:
            active[s] = later + band - 1
            rate[s, 0] = 1.0
            state[active[s]] += change
    return begin, active, rate


@numba.njit(cache=True, boundscheck=False)
def slopes_part(begin, active, rate, sums, n_first, q):
    """What the moving columns add to the Gram matrix and the right-hand side.

    The Gram matrix of a block is begin' diag(n) begin + part + part'; the diagonal block of
    the moving columns is halved in ``part`` accordingly.
    """
    count, p = begin.shape
    part = np.zeros((p, p))  # part[j] is row of the moving column j
    right = np.zeros(p)
    total = np.zeros(p)
    for s in range(count):
        n = sums[s, 0]
        if n == 0.0:
            continue
        width = q if (active[s] == n_first and q > 1) else 1
        for j in range(p):
            right[j] += begin[s, j] * sums[s, 3]
            total[j] += begin[s, j] * n
        for k in range(width):
            column = active[s] + k
            r = rate[s, k]
            f = r * sums[s, 1]
            for j in range(p):
                part[column, j] += f * begin[s, j]
            right[column] += r * sums[s, 4]
            total[column] += f
            for m in range(width):
                part[column, active[s] + m] += 0.5 * r * rate[s, m] * sums[s, 2]
    return part, right, total
