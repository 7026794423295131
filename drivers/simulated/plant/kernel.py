"""The stack's equations of motion, advanced exactly from one instant to the next.

The drive is piecewise constant before the amplifier's lag, so within a step it
moves one way along a known exponential. Hysteresis depends only on where it
ends; relaxations and the mounted mode are linear and have closed forms. Results
do not depend on how finely the instants are chosen.

State lives in three float arrays: scalars ``s`` (indices in ``state.py``), walls ``w`` and
relaxations ``q``. ``c``, ``walls`` and ``relax`` are constant; ``memo`` holds the
exponentials of the last few step lengths. Units: um, V, s.
"""

from __future__ import annotations

import math

import numba

from drivers.simulated.plant.state import (
    AGED,
    BEGIN,
    BEGIN_BELOW,
    BEGIN_WEIGHT,
    CYCLE,
    DENSITY,
    DENSITY_BELOW,
    DIRECTION,
    DRIVE,
    EXCESS,
    EXCURSION,
    EXTREME,
    HEADING,
    HIGHEST,
    LAGGED_DRIVE,
    LOWEST,
    MEMO_SLOTS,
    MEMORY,
    MIRROR,
    MODE,
    MODE_SPEED,
    REST,
    REST_DRIVE,
    SLIDING,
    SPAN,
    STATIC,
    STRENGTH,
    TARGET,
    TIME,
    TURNED_AT,
    WALLS,
    WEIGHT,
)
from drivers.simulated.plant.strangers_kernel import add_strangers

SETTLED_V = 1e-9
TOLERANCE_S = 1e-9
LONGEST_MOVING_STEP_S = 2e-4
LONGEST_RECOVERING_STEP_S = 0.05
REVERSAL_V = 0.05
LONGEST_STRETCH_V = 0.25
VISCOSITY_WINDOW_S = 3e-3


@numba.njit(cache=True, error_model="numpy", forceinline=True)
def _static(c, s):
    """Displacement without relaxation and ageing, from the state of walls and drive."""
    v = s[DRIVE]
    m = max(s[HIGHEST], -s[LOWEST])
    first = c.initiation * (1.0 - math.exp(-((m / c.initiation_scale) ** 2)))
    x = s[BEGIN] / c.begin_max
    asymmetry = -0.5 * c.asymmetry * c.begin_max * x * x
    return (c.reversible + c.curvature * v) * v + s[WALLS] + s[EXCESS] + first + asymmetry


@numba.njit(cache=True, error_model="numpy", forceinline=True)
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


@numba.njit(cache=True, error_model="numpy")
def _halt(c, walls, s, w):
    """Write down where the sliding walls are, and let none slide."""
    for i in range(int(s[SLIDING])):
        w[i] = s[DRIVE] - s[HEADING] * walls[STRENGTH, i]
    s[SLIDING] = 0.0


@numba.njit(cache=True, error_model="numpy")
def _move(c, walls, s, w, v):
    """Bring the drive to v: walls slide, memory of the excursion follows.

    Weaker walls always slide before stronger ones, and those that slide keep
    pace with the drive, so only their number needs to be followed.
    """
    travel = v - s[DRIVE]
    heading = 1.0 if travel > 0.0 else -1.0
    if heading != s[HEADING]:
        _halt(c, walls, s, w)
        s[HEADING] = heading
    sliding = int(s[SLIDING])
    slid = travel * walls[DENSITY_BELOW, sliding]
    slid_begin = travel * walls[BEGIN_BELOW, sliding]
    while sliding < w.size:
        step = v - heading * walls[STRENGTH, sliding] - w[sliding]
        if step * heading <= 0.0:
            break
        slid += walls[DENSITY, sliding] * step
        slid_begin += walls[BEGIN_WEIGHT, sliding] * step
        sliding += 1
    s[SLIDING] = sliding
    _turn(c, s, v)
    released = travel - slid_begin
    s[WALLS] += slid
    s[BEGIN] += released
    slope = c.range_size * s[EXCURSION] + c.extremum_size * s[TURNED_AT]
    distance = abs(travel)
    s[EXCESS] -= slope * released
    s[DRIVE] = v
    s[HIGHEST] = max(s[HIGHEST], v)
    s[LOWEST] = min(s[LOWEST], v)
    excursion = min(abs(v - s[TURNED_AT]), s[HIGHEST] - s[LOWEST])
    s[EXCURSION] = max(s[EXCURSION] * math.exp(-distance / c.range_fade), excursion)
    unaged = _static(c, s)
    if c.aging != 0.0:
        s[AGED] += (unaged - (s[STATIC] - s[AGED])) * c.aging * math.log10(s[CYCLE])
    s[STATIC] = unaged + s[AGED]


@numba.njit(cache=True, error_model="numpy", forceinline=True)
def _travel(c, walls, s, w, v):
    """Bring the drive to v, a long way in short stretches: the memory changes on the way."""
    stretches = max(1, math.ceil(abs(v - s[DRIVE]) / LONGEST_STRETCH_V))
    start = s[DRIVE]
    for i in range(1, stretches):
        _move(c, walls, s, w, start + (v - start) * i / stretches)
    _move(c, walls, s, w, v)


@numba.njit(cache=True, error_model="numpy")
def _forget(c, walls, s, w, q, factor):
    """Erase memory at rest: everything but the drive shrinks by ``factor``."""
    _halt(c, walls, s, w)
    v = s[DRIVE]
    old = s[STATIC]
    moved = 0.0
    begin = v
    for i in range(w.size):
        w[i] = min(v + walls[STRENGTH, i], max(v - walls[STRENGTH, i], factor * w[i]))
        moved += walls[DENSITY, i] * w[i]
        begin -= walls[BEGIN_WEIGHT, i] * w[i]
    s[WALLS] = moved
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


@numba.njit(cache=True, error_model="numpy", forceinline=True)
def _rest(c, walls, s, w, q, dt):
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
    _forget(c, walls, s, w, q, left / s[MEMORY])
    s[MEMORY] = left
    if s[REST] >= 0.5 * c.recovery_end:  # virgin: the next rise is no reversal, but the first
        s[DIRECTION] = 0.0
        s[EXTREME] = s[DRIVE]


@numba.njit(cache=True, error_model="numpy", forceinline=True)
def _recovering(c, s):
    return c.recovery_time > 0.0 and s[MEMORY] > c.remanence and abs(s[DRIVE]) <= c.rest_band


@numba.njit(cache=True, error_model="numpy", forceinline=True)
def _factors(c, relax, memo, dt):
    """Row of the memo for a step dt: exponentials of lag, relaxations, mode, viscosity."""
    for k in range(MEMO_SLOTS):
        if abs(memo[k, 0] - dt) <= 1e-6 * dt:
            return k
    for k in range(MEMO_SLOTS - 1, 0, -1):
        for j in range(memo.shape[1]):  # a whole row would take seconds more to compile
            memo[k, j] = memo[k - 1, j]
    n = relax.shape[1]
    memo[0, 0] = dt
    memo[0, 1] = math.exp(-dt / c.tau) if c.tau > 0.0 else 0.0
    memo[0, 2] = math.exp(-dt / VISCOSITY_WINDOW_S)
    omega = 2.0 * math.pi * c.frequency
    fast = omega * math.sqrt(1.0 - c.damping * c.damping)
    fall = math.exp(-c.damping * omega * dt)
    ratio = c.damping * omega / fast
    memo[0, 3] = fall * (math.cos(fast * dt) + ratio * math.sin(fast * dt))
    memo[0, 4] = fall * math.sin(fast * dt) / fast
    memo[0, 5] = -omega * omega * memo[0, 4]
    memo[0, 6] = fall * (math.cos(fast * dt) - ratio * math.sin(fast * dt))
    for j in range(n):
        memo[0, 8 + j] = math.exp(-dt / relax[SPAN, j])
        apart = c.tau - relax[SPAN, j]
        if abs(apart) < 1e-6 * relax[SPAN, j]:
            apart = 1e-6 * relax[SPAN, j]
        memo[0, 8 + n + j] = c.tau / apart
    return 0


@numba.njit(cache=True, error_model="numpy", forceinline=True)
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


@numba.njit(cache=True, error_model="numpy", forceinline=True)
def _step(c, walls, relax, s, w, q, memo, dt):
    m = _factors(c, relax, memo, dt)
    n = q.size
    start = s[STATIC]
    drive = s[DRIVE]
    moved = drive != s[TARGET]
    overshoot = 0.0  # how far the static displacement is from where its exponential ends
    if moved:
        _travel(c, walls, s, w, _amplifier(c, drive, s[TARGET], dt, memo[m, 1]))
        if c.tau > 0.0 and c.slew == 0.0:
            overshoot = (s[STATIC] - start) / (1.0 - memo[m, 1])
    end = start + overshoot if overshoot != 0.0 else s[STATIC]
    for j in range(n):
        part = -overshoot * memo[m, 8 + n + j]
        q[j] = end + part * memo[m, 1] + (q[j] - end - part) * memo[m, 8 + j]
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
    s[MODE] = end + part * memo[m, 1] + memo[m, 3] * place + memo[m, 4] * velocity
    s[MODE_SPEED] = speed * memo[m, 1] + memo[m, 5] * place + memo[m, 6] * velocity
    s[LAGGED_DRIVE] = s[DRIVE] + (s[LAGGED_DRIVE] - s[DRIVE]) * memo[m, 2]
    _rest(c, walls, s, w, q, dt)


@numba.njit(cache=True, error_model="numpy", forceinline=True)
def _displacement(c, relax, s, q, travel, dt):
    x = s[STATIC] + c.participation * (s[MODE] - s[STATIC])
    for j in range(q.size):
        x += relax[WEIGHT, j] * q[j]
    if c.viscosity != 0.0:
        rate = (s[DRIVE] - s[LAGGED_DRIVE]) / VISCOSITY_WINDOW_S
        lag = c.viscosity * abs(rate / 300.0) ** c.viscosity_exponent
        x -= math.copysign(lag, rate)
    if c.strangers.present:
        x = add_strangers(c, s, x, travel, dt)
    return x


@numba.njit(cache=True, error_model="numpy", forceinline=True)
def _advance(c, walls, relax, s, w, q, memo, t):
    """Advance to t under a constant target: short steps while anything moves."""
    while t - s[TIME] > 1e-12:
        dt = t - s[TIME]
        last = True
        if s[TARGET] != s[DRIVE] and dt > 1.5 * LONGEST_MOVING_STEP_S:
            dt = LONGEST_MOVING_STEP_S
            last = False
        elif _recovering(c, s) and dt > 1.5 * LONGEST_RECOVERING_STEP_S:
            dt = LONGEST_RECOVERING_STEP_S
            last = False
        before = s[DRIVE]
        _step(c, walls, relax, s, w, q, memo, dt)
        if c.strangers.present:
            _displacement(c, relax, s, q, s[DRIVE] - before, dt)
        s[TIME] = t if last else s[TIME] + dt


@numba.njit(cache=True, error_model="numpy", forceinline=True)
def _aim(c, walls, s, w, target):
    """A new target; without lag and slew limit the drive is there at once."""
    s[TARGET] = target
    if c.tau <= 0.0 and c.slew <= 0.0 and target != s[DRIVE]:
        travel = target - s[DRIVE]
        _travel(c, walls, s, w, target)
        return travel
    return 0.0


@numba.njit(cache=True, error_model="numpy")
def march(
    c, walls, relax, s, w, q, memo, begin, rate, targets, next_target, until, times, out_v, out_x
):
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
        new_target = tick <= times[i] + TOLERANCE_S and tick < until - TOLERANCE_S
        here = times[i] < until - TOLERANCE_S
        instant = tick if new_target else (times[i] if here else until)
        _advance(c, walls, relax, s, w, q, memo, instant)
        travel = 0.0
        if new_target:
            travel = _aim(c, walls, s, w, targets[k])
            k += 1
            if not c.strangers.present:
                continue
        elif not here:
            return i
        x = _displacement(c, relax, s, q, travel, 0.0)
        if not new_target:
            out_v[i] = s[DRIVE]
            out_x[i] = x
            i += 1
    return i


@numba.njit(cache=True, error_model="numpy")
def settle(c, walls, s, w, q, v):
    """Put the actuator at v as if it had risen there from the virgin state long ago."""
    s[TARGET] = v
    if v != s[DRIVE]:
        _travel(c, walls, s, w, v)
    q.fill(s[STATIC])
    s[MODE] = s[STATIC]
    s[MODE_SPEED] = 0.0
    s[LAGGED_DRIVE] = v
    s[REST_DRIVE] = v
    s[MIRROR] = s[STATIC]
