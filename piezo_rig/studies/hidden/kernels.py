"""Compiled loops of the bench: play operators, branches with a memory, lags, relays."""

from __future__ import annotations

import math

import numba
import numpy as np


@numba.njit(cache=True)
def played_on(drive, thresholds, state):
    """Play operators (n, m) from a state (m,), which is left as it is at the end."""
    n, m = drive.size, thresholds.size
    out = np.empty((n, m))
    for i in range(n):
        v = drive[i]
        for j in range(m):
            state[j] = min(max(state[j], v - thresholds[j]), v + thresholds[j])
            out[i, j] = state[j]
    return out


@numba.njit(cache=True)
def played_sum(drive, thresholds, weights, wider):
    """Weighted sum of play operators, shape (n,)."""
    n, m = drive.size, thresholds.size
    out = np.empty(n)
    state = np.zeros(m)
    for i in range(n):
        v = drive[i]
        total = 0.0
        for j in range(m):
            r = thresholds[j] + wider[i]
            s = min(max(state[j], v - r), v + r)
            state[j] = s
            total += weights[j] * s
        out[i] = total
    return out


@numba.njit(cache=True)
def _table(u, knots, values, last):
    """Piecewise linear through (knots, values), which begin at 0; ``last`` slope beyond."""
    n = knots.size
    if u >= knots[n - 1]:
        return values[n - 1] + (u - knots[n - 1]) * last
    low, high = 0, n - 1
    while high - low > 1:
        middle = (low + high) // 2
        if knots[middle] <= u:
            low = middle
        else:
            high = middle
    share = (u - knots[low]) / (knots[high] - knots[low])
    return values[low] + share * (values[high] - values[low])


@numba.njit(cache=True)
def _branch(u, slope, bump, reach, first_break, knots, values, last):
    """Displacement of a later branch ``u`` volts after its turning point."""
    if u <= slope * first_break:
        y = u / slope
    else:
        y = first_break + _table(u - slope * first_break, knots, values, last)
    if bump != 0.0:
        y += bump * reach * (1.0 - math.exp(-u / reach))
    return y


@numba.njit(cache=True)
def branched(
    drive, first_knots, first_values, first_last, slope, first_break, knots, values, last,
    per_range, per_extremum, ratio, bump_per_range, bump_direction, reach,
):  # fmt: skip
    """Displacement (n,) of an actuator with Madelung's memory, 0 at the first sample.

    A later branch begins with ``slope + per_range x range + per_extremum x extremum`` V/um for
    ``first_break`` um (times 2r/(1+r) upwards, 2/(1+r) downwards), then follows the table. The
    bump is an extra compliance that dies out over ``reach`` volts. Displacement is continuous;
    an interrupted branch is resumed where its turning point is passed again.
    """
    n = drive.size
    turns = 2
    for i in range(2, n):
        if (drive[i] - drive[i - 1]) * (drive[i - 1] - drive[i - 2]) <= 0.0:
            turns += 1
    at = np.empty(turns + 2)
    slopes = np.empty(turns + 2)
    bumps = np.empty(turns + 2)
    out = np.zeros(n)
    top = 0
    at[0] = drive[0]
    previous_turn = drive[0]
    way = 0.0
    y = 0.0
    for i in range(1, n):
        v, position = drive[i], drive[i - 1]
        if v == position:
            out[i] = y
            continue
        d = 1.0 if v > position else -1.0
        if way != 0.0 and d != way:
            change = abs(position - previous_turn)
            previous_turn = position
            top += 1
            at[top] = position
            s = slope + per_range * change + per_extremum * position
            s *= (2.0 * ratio if d > 0 else 2.0) / (1.0 + ratio)
            slopes[top] = s
            bumps[top] = bump_per_range * change + bump_direction * d
        way = d
        while True:
            if top == 0:
                here = _table(abs(v - at[0]), first_knots, first_values, first_last)
                there = _table(abs(position - at[0]), first_knots, first_values, first_last)
                y += d * (here - there)
                break
            limit = at[top - 1] if top > 1 else 2.0 * at[0] - at[1]
            end = v if d * (limit - v) >= 0.0 else limit
            here = _branch(abs(end - at[top]), slopes[top], bumps[top], reach, first_break,
                           knots, values, last)  # fmt: skip
            there = _branch(abs(position - at[top]), slopes[top], bumps[top], reach, first_break,
                            knots, values, last)  # fmt: skip
            y += d * (here - there)
            if end == v:
                break
            position = limit
            top = max(top - 2, 0)
        out[i] = y
    return out


@numba.njit(cache=True)
def first_order(time, x, tau):
    """x behind a first-order lag, exact where x is straight between samples; settled at first."""
    out = np.empty(x.size)
    lag = 0.0  # x - q
    out[0] = x[0]
    for i in range(1, x.size):
        step = time[i] - time[i - 1]
        decay = math.exp(-step / tau)
        lag = lag * decay + (x[i] - x[i - 1]) / step * tau * (1.0 - decay)
        out[i] = x[i] - lag
    return out


@numba.njit(cache=True)
def relaxing(time, x, taus, weights):
    """Sum of weighted first-order responses to x - x[0], shape (n,)."""
    out = np.zeros(x.size)
    lags = np.zeros(taus.size)
    for i in range(1, x.size):
        step = time[i] - time[i - 1]
        slope = (x[i] - x[i - 1]) / step
        total = 0.0
        for k in range(taus.size):
            decay = math.exp(-step / taus[k])
            lags[k] = lags[k] * decay + slope * taus[k] * (1.0 - decay)
            total += weights[k] * (x[i] - x[0] - lags[k])
        out[i] = total
    return out




@numba.njit(cache=True)
def relayed(drive, low, high):
    """1 after ``high`` was passed rising, 0 after ``low`` was passed falling, shape (n,)."""
    out = np.empty(drive.size)
    state = 0.0
    for i in range(drive.size):
        if drive[i] >= high:
            state = 1.0
        elif drive[i] <= low:
            state = 0.0
        out[i] = state
    return out


@numba.njit(cache=True)
def slowed(time, drive, limit, fine):
    """A drive (n,) that another one pulls along at no more than ``limit`` per second.

    In ``fine`` small steps a sample, the drive straight between samples.
    """
    out = np.empty(drive.size)
    here = drive[0]
    out[0] = here
    for i in range(1, drive.size):
        most = (time[i] - time[i - 1]) / fine * limit
        for k in range(1, fine + 1):
            goal = drive[i - 1] + (drive[i] - drive[i - 1]) * k / fine
            if goal > here:
                here = min(goal, here + most)
            else:
                here = max(goal, here - most)
        out[i] = here
    return out
