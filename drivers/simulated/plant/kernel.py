"""The stack's equations of motion, advanced exactly from one instant to the next.

The drive is piecewise constant before the amplifier's lag, so within a step it
moves one way along a known exponential. Hysteresis depends only on where it
ends; relaxations and the mounted mode are linear and have closed forms. Results
do not depend on how finely the instants are chosen.

State lives in three float arrays: scalars ``s`` (indices below), walls ``w`` and
relaxations ``q``. ``c`` holds the constants, ``memo`` the exponentials of the
last few step lengths. Units: um, V, s.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from drivers.simulated.plant.strangers_kernel import add_strangers

Array = NDArray[np.float64]

# Scalars of the state. TIME, drive and what it heads for:
TIME, DRIVE, TARGET = 0, 1, 2
# moved walls z, walls at the beginning of a branch e, strain that depends on excursion
WALLS, BEGIN, EXCESS = 3, 4, 5
# recent excursion, largest and smallest drive since recovery
EXCURSION, HIGHEST, LOWEST = 6, 7, 8
# turning points: direction, running extreme, drive at the last one, cycle number, aged share
DIRECTION, EXTREME, TURNED_AT, CYCLE, AGED = 9, 10, 11, 12, 13
# quasi-static displacement before relaxation; mode's place and speed; drive seen by viscosity
STATIC, MODE, MODE_SPEED, LAGGED_DRIVE = 14, 15, 16, 17
# rest: since when (s), at which drive, memory left of what it began with
REST, REST_DRIVE, MEMORY = 18, 19, 20
# strangers: parity smoothed over travel, heat, mirror behind a gap
PARITY, HEAT, MIRROR = 21, 22, 23
SCALARS = 24

SETTLED_V = 1e-9
TOLERANCE_S = 1e-9
LONGEST_MOVING_STEP_S = 2e-4
LONGEST_RECOVERING_STEP_S = 0.05
REVERSAL_V = 0.05
VISCOSITY_WINDOW_S = 3e-3
EXCESS_FADES_OVER_V = 400.0
MEMORY_AFTER_REST = 1e-5

MEMO_SLOTS = 4


class Constants(NamedTuple):
    """What the kernel needs of the config; an effect that is off has size zero."""

    tau: float
    slew: float  # 0: unlimited
    r: Array
    density: Array
    begin: Array
    begin_max: float
    reversible: float
    curvature: float
    initiation: float
    initiation_scale: float
    range_size: float  # um/V per V
    range_fade: float
    extremum_size: float  # um/V per V
    asymmetry: float  # um/V
    aging: float
    aging_resets: float
    creep_time: Array
    creep_weight: Array
    viscosity: float
    viscosity_exponent: float
    frequency: float
    damping: float
    participation: float
    recovery_time: float  # time constant; 0: never
    hold_off: float
    recovery_end: float
    rest_band: float
    remanence: float
    strangers: Array  # see strangers_kernel.py


def new_state(c: Constants) -> tuple[Array, Array, Array, Array]:
    """A virgin actuator at 0 V at time 0: scalars, walls, relaxations, memo."""
    s = np.zeros(SCALARS)
    s[[CYCLE, MEMORY]] = 1.0
    s[PARITY] = 1.0
    n = c.creep_time.size
    memo = np.zeros((MEMO_SLOTS, 2 * n + 8))
    memo[:, 0] = -1.0
    return s, np.zeros(c.r.size), np.zeros(n), memo


@numba.njit(cache=True)
def _static(c, s):
    """Displacement without relaxation and ageing, from the state of walls and drive."""
    v = s[DRIVE]
    m = max(s[HIGHEST], -s[LOWEST])
    first = c.initiation * (1.0 - math.exp(-((m / c.initiation_scale) ** 2)))
    x = s[BEGIN] / c.begin_max
    asymmetry = -0.5 * c.asymmetry * c.begin_max * x * x
    return (c.reversible + c.curvature * v) * v + s[WALLS] + s[EXCESS] + first + asymmetry


@numba.njit(cache=True)
def _turn(c, s, v):
    """Follow the drive's direction; a reversal counts once it exceeds REVERSAL_V."""
    if s[DIRECTION] >= 0.0:
        if v > s[EXTREME]:
            s[EXTREME] = v
            s[DIRECTION] = 1.0
        elif s[EXTREME] - v > REVERSAL_V:
            s[TURNED_AT] = s[EXTREME]
            s[DIRECTION] = -1.0
            s[EXTREME] = v
    else:
        if v < s[EXTREME]:
            s[EXTREME] = v
        elif v - s[EXTREME] > REVERSAL_V:
            s[TURNED_AT] = s[EXTREME]
            s[DIRECTION] = 1.0
            s[EXTREME] = v
            s[CYCLE] += 1.0


@numba.njit(cache=True)
def _move(c, s, w, v):
    """Bring the drive to v: walls slide, memory of the excursion follows."""
    travel = v - s[DRIVE]
    before = _static(c, s)
    _turn(c, s, v)
    slid = 0.0
    slid_begin = 0.0
    front = 0.0
    for i in range(w.size):  # weaker walls always slide before stronger ones
        low = v - c.r[i]
        high = v + c.r[i]
        if w[i] < low:
            step = low - w[i]
        elif w[i] > high:
            step = high - w[i]
        else:
            break
        w[i] += step
        slid += c.density[i] * step
        slid_begin += c.begin[i] * step
        front = c.r[i]
    released = travel - slid_begin
    s[WALLS] += slid
    s[BEGIN] += released
    slope = c.range_size * s[EXCURSION] + c.extremum_size * s[TURNED_AT]
    distance = abs(travel)
    s[EXCESS] -= slope * released + s[EXCESS] * min(1.0, distance / EXCESS_FADES_OVER_V)
    s[DRIVE] = v
    s[HIGHEST] = max(s[HIGHEST], v)
    s[LOWEST] = min(s[LOWEST], v)
    excursion = min(2.0 * front, s[HIGHEST] - s[LOWEST])
    s[EXCURSION] = max(s[EXCURSION] * math.exp(-distance / c.range_fade), excursion)
    change = _static(c, s) - before
    if c.aging != 0.0:
        s[AGED] += change * c.aging * math.log10(s[CYCLE])
    s[STATIC] += change
    if c.aging != 0.0:
        s[STATIC] = _static(c, s) + s[AGED]


@numba.njit(cache=True)
def _forget(c, s, w, q, factor):
    """Erase memory at rest: everything but the drive shrinks by ``factor``."""
    v = s[DRIVE]
    old = s[STATIC]
    walls = 0.0
    begin = v
    for i in range(w.size):
        w[i] = min(v + c.r[i], max(v - c.r[i], factor * w[i]))
        walls += c.density[i] * w[i]
        begin -= c.begin[i] * w[i]
    s[WALLS] = walls
    s[BEGIN] = begin
    for i in (EXCESS, EXCURSION, AGED, TURNED_AT):
        s[i] *= factor
    s[HIGHEST] = max(v, factor * s[HIGHEST])
    s[LOWEST] = min(v, factor * s[LOWEST])
    if c.aging_resets > 0.0:
        s[CYCLE] = 1.0 + (s[CYCLE] - 1.0) * factor
    s[STATIC] = _static(c, s) + s[AGED]
    for j in range(q.size):
        q[j] = s[STATIC] + (q[j] - old) * factor
    s[MODE] += s[STATIC] - old


@numba.njit(cache=True)
def _rest(c, s, w, q, dt):
    """Count the time at rest and let the memory decay."""
    if abs(s[DRIVE]) > c.rest_band or abs(s[DRIVE] - s[REST_DRIVE]) > 0.01:
        s[REST] = 0.0
        s[MEMORY] = 1.0
        s[REST_DRIVE] = s[DRIVE]
        return
    s[REST] += dt
    if c.recovery_time <= 0.0 or s[REST] <= c.hold_off or s[MEMORY] <= c.remanence:
        return
    left = c.remanence
    if s[REST] < c.recovery_end:
        decay = math.exp(-(s[REST] - c.hold_off) / c.recovery_time)
        left += (1.0 - c.remanence) * decay
    _forget(c, s, w, q, left / s[MEMORY])
    s[MEMORY] = left
    if left == 0.0:
        s[DIRECTION] = 0.0
        s[EXTREME] = s[DRIVE]


@numba.njit(cache=True)
def _factors(c, memo, dt):
    """Row of the memo for a step dt: exponentials of lag, relaxations, mode, viscosity."""
    for k in range(MEMO_SLOTS):
        if abs(memo[k, 0] - dt) <= 1e-6 * dt:
            return k
    for k in range(MEMO_SLOTS - 1, 0, -1):
        memo[k] = memo[k - 1]
    n = c.creep_time.size
    row = memo[0]
    row[0] = dt
    row[1] = math.exp(-dt / c.tau) if c.tau > 0.0 else 0.0
    row[2] = math.exp(-dt / VISCOSITY_WINDOW_S)
    omega = 2.0 * math.pi * c.frequency
    fast = omega * math.sqrt(1.0 - c.damping * c.damping)
    fall = math.exp(-c.damping * omega * dt)
    ratio = c.damping * omega / fast
    row[3] = fall * (math.cos(fast * dt) + ratio * math.sin(fast * dt))
    row[4] = fall * math.sin(fast * dt) / fast
    row[5] = -omega * omega * row[4]
    row[6] = fall * (math.cos(fast * dt) - ratio * math.sin(fast * dt))
    for j in range(n):
        row[8 + j] = math.exp(-dt / c.creep_time[j])
        apart = c.tau - c.creep_time[j]
        if abs(apart) < 1e-6 * c.creep_time[j]:
            apart = 1e-6 * c.creep_time[j]
        row[8 + n + j] = c.tau / apart
    return 0


@numba.njit(cache=True)
def _amplifier(c, v, target, dt, lag):
    """Drive after dt: at the slew limit while that binds, then the lag's exponential."""
    if c.slew > 0.0:
        gap = target - v
        linear = abs(gap) - c.slew * c.tau
        if linear > 0.0:
            if linear >= c.slew * dt:
                return v + math.copysign(c.slew * dt, gap)
            v += math.copysign(linear, gap)
            dt -= linear / c.slew
            lag = math.exp(-dt / c.tau) if c.tau > 0.0 else 0.0
    v = target + (v - target) * lag
    return target if abs(v - target) < SETTLED_V else v


@numba.njit(cache=True)
def _step(c, s, w, q, memo, dt):
    row = memo[_factors(c, memo, dt)]
    n = q.size
    start = s[STATIC]
    drive = s[DRIVE]
    moved = drive != s[TARGET]
    overshoot = 0.0  # how far the static displacement is from where its exponential ends
    if moved:
        _move(c, s, w, _amplifier(c, drive, s[TARGET], dt, row[1]))
        if c.tau > 0.0 and c.slew == 0.0:
            overshoot = (s[STATIC] - start) / (1.0 - row[1])
    end = start + overshoot if overshoot != 0.0 else s[STATIC]
    for j in range(n):
        part = -overshoot * row[8 + n + j]
        q[j] = end + part * row[1] + (q[j] - end - part) * row[8 + j]
    omega = 2.0 * math.pi * c.frequency
    part = 0.0
    speed = 0.0
    if overshoot != 0.0:
        rate = 1.0 / c.tau
        gain = omega * omega / (rate * (rate - 2.0 * c.damping * omega) + omega * omega)
        part = -overshoot * gain
        speed = -part * rate
    place = s[MODE] - end - part
    velocity = s[MODE_SPEED] - speed
    s[MODE] = end + part * row[1] + row[3] * place + row[4] * velocity
    s[MODE_SPEED] = speed * row[1] + row[5] * place + row[6] * velocity
    s[LAGGED_DRIVE] = s[DRIVE] + (s[LAGGED_DRIVE] - s[DRIVE]) * row[2]
    _rest(c, s, w, q, dt)


@numba.njit(cache=True)
def _displacement(c, s, q, travel, dt):
    x = s[STATIC] + c.participation * (s[MODE] - s[STATIC])
    for j in range(q.size):
        x += c.creep_weight[j] * q[j]
    if c.viscosity != 0.0:
        rate = (s[DRIVE] - s[LAGGED_DRIVE]) / VISCOSITY_WINDOW_S
        lag = c.viscosity * abs(rate / 300.0) ** c.viscosity_exponent
        x -= math.copysign(lag, rate)
    if c.strangers[0] > 0.0:
        x = add_strangers(c, s, x, travel, dt)
    return x


@numba.njit(cache=True)
def _advance(c, s, w, q, memo, t):
    """Advance to t under a constant target: short steps while anything moves."""
    while t - s[TIME] > 1e-12:
        dt = t - s[TIME]
        last = True
        if s[TARGET] != s[DRIVE] and dt > 1.5 * LONGEST_MOVING_STEP_S:
            dt = LONGEST_MOVING_STEP_S
            last = False
        elif s[MEMORY] > c.remanence and abs(s[DRIVE]) <= c.rest_band:
            if c.recovery_time > 0.0 and dt > 1.5 * LONGEST_RECOVERING_STEP_S:
                dt = LONGEST_RECOVERING_STEP_S
                last = False
        before = s[DRIVE]
        _step(c, s, w, q, memo, dt)
        if c.strangers[0] > 0.0:
            _displacement(c, s, q, s[DRIVE] - before, dt)
        s[TIME] = t if last else s[TIME] + dt


@numba.njit(cache=True)
def _aim(c, s, w, target):
    """A new target; without lag and slew limit the drive is there at once."""
    s[TARGET] = target
    if c.tau <= 0.0 and c.slew <= 0.0 and target != s[DRIVE]:
        travel = target - s[DRIVE]
        _move(c, s, w, target)
        return travel
    return 0.0


@numba.njit(cache=True)
def march(c, s, w, q, memo, begin, rate, targets, next_target, until, times, out_v, out_x):
    """Advance through one segment of drive, sampling at ``times`` on the way.

    Parameters
    ----------
    begin, rate, targets : target k holds from begin + k / rate on
    next_target : first target that is still to come
    until : end of the segment; samples at or after it are left to the next one
    times : instants to sample, ascending
    out_v, out_x : drive in V and displacement in um at these instants

    Returns
    -------
    how many of ``times`` were sampled; if all, the state stands at the last one,
    else at ``until``.
    """
    k = next_target
    i = 0
    while i < times.size:
        tick = begin + k / rate if k < targets.size else math.inf
        if tick <= times[i] + TOLERANCE_S and tick < until - TOLERANCE_S:
            _advance(c, s, w, q, memo, tick)
            travel = _aim(c, s, w, targets[k])
            if c.strangers[0] > 0.0:
                _displacement(c, s, q, travel, 0.0)
            k += 1
        elif times[i] < until - TOLERANCE_S:
            _advance(c, s, w, q, memo, times[i])
            out_v[i] = s[DRIVE]
            out_x[i] = _displacement(c, s, q, 0.0, 0.0)
            i += 1
        else:
            _advance(c, s, w, q, memo, until)
            return i
    return i


@numba.njit(cache=True)
def settle(c, s, w, q, v):
    """Put the actuator at v as if it had risen there from the virgin state long ago."""
    s[TARGET] = v
    steps = 1000
    start = s[DRIVE]
    for i in range(1, steps + 1):
        _move(c, s, w, start + (v - start) * i / steps)
    q[:] = s[STATIC]
    s[MODE] = s[STATIC]
    s[MODE_SPEED] = 0.0
    s[LAGGED_DRIVE] = v
    s[REST_DRIVE] = v
    s[MIRROR] = s[STATIC]
