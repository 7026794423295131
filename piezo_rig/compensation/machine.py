"""A model that goes along a drive sample by sample, forwards and backwards; compiled.

`move` takes one step: drive in, displacement out. A step is tried first (`attempt`), as often as
needed, and then taken (`take`); a try costs no copy, because it writes only where nothing is
remembered. `play` goes along a drive; `follow` finds, sample after sample, the drive whose
displacement is the target's. Neither looks ahead.

The memory of the sliders follows Madelung's rules as `piezo_rig.chain.kernels.walk` does, which
cuts whole monotone runs and is faster. Half loops are counted as they come: a branch is taken to
begin one, and a reversal that stays within the dead band leaves the count as it was.

The compiled code is kept with this file and holds that of `operations`, a change of which it does
not notice: touch both.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from piezo_rig.compensation.operations import (
    MEMORY,
    SMALLEST_V,
    STRETCH,
    WIDEN,
    begin,
    prepare,
    step,
    stretched,
    widened,
)
from piezo_rig.compensation.tables import Tables

FloatArray = NDArray[np.float64]

# Scalars: drive that the sliders see, displacement of the springs, virgin drive, where the half
# loop began that counts, its extreme so far, drive as commanded, displacement at the first sample,
# length of the last step, where the half loop before began; of a try: drive seen, displacement of
# the springs.
SEEN, SPRINGS, ORIGIN, BEGUN, EXTREME, DRIVE, ZERO, STEP, BEFORE, TRY_SEEN, TRY_SPRINGS = range(11)
# Turning points remembered, way that the sliders last went (-1, 0, 1), way of the half loop that
# counts; of a try: turning points and band after it, whether a slope of the branch is not positive.
DEPTH, WAY, LOOP_WAY, TRY_DEPTH, TRY_BAND, TRY_BAD = range(6)

DONE, NO_ROOM, BAD_SLOPE, OUT_OF_REACH = range(4)

EXACT_UM = 1e-12
STAYS_UM = 1e-11
MISSED_UM = 1e-6  # a target that was written with six digits
TRIES = 200


class State(NamedTuple):
    """Everything that a model remembers; written by this module alone.

    ``memory``, ``fresh``, ``cache`` : of the operations, before a step, after it, for its length.
    ``turn`` (r,), ``knots``, ``slopes`` (r, e), ``band`` (r + 1,) : the turning points that are
    remembered, outermost first, the branch from each, and the band of it that was reached.
    """

    scalars: FloatArray
    counts: NDArray[np.int64]
    memory: FloatArray
    fresh: FloatArray
    cache: FloatArray
    turn: FloatArray
    knots: FloatArray
    slopes: FloatArray
    band: NDArray[np.int64]


def new_state(tables: Tables, room: int = 64) -> State:
    """An empty state, with room for that many turning points."""
    (m, numbers), e = tables.numbers.shape, tables.widths_um.size
    memory = max(MEMORY, numbers)
    return State(
        np.zeros(11), np.zeros(6, np.int64), np.zeros((m, memory)), np.zeros((m, memory)),
        np.zeros((m, numbers)), np.zeros(room), np.zeros((room, e)), np.zeros((room, e)),
        np.zeros(room + 1, np.int64),
    )  # fmt: skip


def with_room(state: State, room: int) -> State:
    """The same state with room for more turning points."""

    def longer(a: NDArray, size: int) -> NDArray:
        return np.concatenate([a, np.zeros((size - a.shape[0], *a.shape[1:]), a.dtype)])

    return state._replace(
        turn=longer(state.turn, room), knots=longer(state.knots, room),
        slopes=longer(state.slopes, room), band=longer(state.band, room + 1),
    )  # fmt: skip


@numba.njit(cache=True)
def _copy(values, into):
    """One by one: whole tables would take seconds more to compile."""
    for j in range(values.shape[0]):
        for k in range(values.shape[1]):
            into[j, k] = values[j, k]


@numba.njit(cache=True)
def start(t, s, drive):
    """A virgin actuator at its first drive."""
    s.counts.fill(0)
    s.band.fill(0)
    w = drive
    for j in range(t.drives):
        w = begin(t.kinds[j], t.numbers[j], s.memory[j], w, w)
    x = 0.0
    for j in range(t.drives, t.kinds.size):
        x = begin(t.kinds[j], t.numbers[j], s.memory[j], x, w)
    s.scalars.fill(0.0)
    s.scalars[SEEN] = w
    s.scalars[ORIGIN] = w
    s.scalars[BEGUN] = w
    s.scalars[BEFORE] = np.nan
    s.scalars[EXTREME] = w
    s.scalars[DRIVE] = drive
    s.scalars[ZERO] = x
    _copy(s.memory, s.fresh)


@numba.njit(cache=True)
def lasts(t, s, step_s):
    """Say how long the next step takes."""
    if s.scalars[STEP] != step_s:
        s.scalars[STEP] = step_s
        for j in range(t.kinds.size):
            prepare(t.kinds[j], t.numbers[j], step_s, s.cache[j])


@numba.njit(cache=True)
def attempt(t, s, drive):
    """Displacement, um, if the drive went there now; `take` makes it so."""
    w = drive
    for j in range(t.drives):
        w = step(t.kinds[j], t.numbers[j], t.caps[j], s.cache[j], s.memory[j], s.fresh[j], w, w)
    seen, more = w, 0.0
    if t.widen >= 0:
        j = t.widen
        if t.kinds[j] == WIDEN:
            seen = widened(t.numbers[j], t.caps[j], s.cache[j], s.memory[j], s.fresh[j], w)
        else:
            more = stretched(t.numbers[j], t.caps[j], s.cache[j], s.memory[j], s.fresh[j], w)
    x = _springs(t, s, seen) + (w - seen) * t.first_compliance + more
    for j in range(t.drives, t.kinds.size):
        if t.kinds[j] != WIDEN and t.kinds[j] != STRETCH:
            x = step(t.kinds[j], t.numbers[j], t.caps[j], s.cache[j], s.memory[j], s.fresh[j], x, w)
    return x - s.scalars[ZERO]


@numba.njit(cache=True)
def _springs(t, s, seen):
    """Displacement of springs and sliders if the drive that they see went there."""
    here = s.scalars[SEEN]
    y = s.scalars[SPRINGS]
    depth = s.counts[DEPTH]
    b = s.band[depth]
    s.counts[TRY_BAD] = 0
    if abs(seen - here) < SMALLEST_V:
        seen = here
    else:
        sign = 1.0 if seen > here else -1.0
        if s.counts[WAY] != 0 and sign != s.counts[WAY]:
            _branch(t, s, depth, here, 1 if sign > 0.0 else 0)
            depth += 1
            b = 0
        while True:
            knot = np.inf
            if depth == 0:
                limit = sign * np.inf
                c = t.init_compliance[b]
                if b < t.init_knots_v.size:
                    knot = t.init_knots_v[b]
                knot = s.scalars[ORIGIN] + sign * knot
            else:
                row = depth - 1
                early = t.widths_um.size
                limit = s.turn[row - 1] if row > 0 else 2.0 * s.scalars[ORIGIN] - s.turn[row]
                if b < early:
                    c = 1.0 / s.slopes[row, b]
                    knot = s.knots[row, b]
                else:
                    c = t.rest_compliance[b - early]
                    if b - early < t.rest_knots_v.size:
                        knot = s.knots[row, early - 1] + t.rest_knots_v[b - early]
                knot = s.turn[row] + sign * knot
            returns = np.isinf(knot) or (limit - knot) * sign <= 0.0
            stop = limit if returns else knot
            tied = t.keeps_ties and returns and seen == stop
            if np.isinf(stop) or (seen - stop) * sign < 0.0 or tied:
                y += c * (seen - here)
                break
            y += c * (stop - here)
            here = stop
            if returns:
                depth = depth - 2 if depth > 1 else 0
                b = s.band[depth]
                if seen == stop:
                    break
            else:
                b += 1
    s.counts[TRY_DEPTH] = depth
    s.counts[TRY_BAND] = b
    s.scalars[TRY_SEEN] = seen
    s.scalars[TRY_SPRINGS] = y
    return y


@numba.njit(cache=True)
def _branch(t, s, row, here, rising):
    """The branch that begins here, written where no turning point is remembered yet."""
    begun = s.scalars[BEGUN]
    range_v = abs(here - begun)
    range_before = abs(begun - s.scalars[BEFORE])
    if np.isnan(range_before):  # the first half loop has no range before it but its own
        range_before = range_v
    more = t.per_volt[rising]
    s.turn[row] = here
    volts = 0.0
    for k in range(t.widths_um.size):
        slope = t.slopes[rising, k] + range_v * more[0, k] + here * more[1, k]
        slope += range_before * more[2, k] + begun * more[3, k]
        if not slope > 0.0:
            s.counts[TRY_BAD] = 1
            slope = 1e-9
        volts += slope * t.widths_um[k]
        s.slopes[row, k] = slope
        s.knots[row, k] = volts


@numba.njit(cache=True)
def take(t, s, drive):
    """Make the last try true; ``drive`` is the one that was tried."""
    seen = s.scalars[TRY_SEEN]
    if seen != s.scalars[SEEN]:
        s.counts[WAY] = 1 if seen > s.scalars[SEEN] else -1
        beyond = seen - s.scalars[EXTREME]
        if s.counts[LOOP_WAY] * beyond > 0.0:
            s.scalars[EXTREME] = seen
        elif abs(beyond) > t.dead_band_v:
            if s.counts[LOOP_WAY] != 0:
                s.scalars[BEFORE] = s.scalars[BEGUN]
                s.scalars[BEGUN] = s.scalars[EXTREME]
            s.counts[LOOP_WAY] = 1 if beyond > 0.0 else -1
            s.scalars[EXTREME] = seen
    s.counts[DEPTH] = s.counts[TRY_DEPTH]
    s.band[s.counts[DEPTH]] = s.counts[TRY_BAND]
    s.scalars[SEEN] = seen
    s.scalars[SPRINGS] = s.scalars[TRY_SPRINGS]
    s.scalars[DRIVE] = drive
    _copy(s.fresh, s.memory)


@numba.njit(cache=True)
def play(t, s, time, drive, out, k):
    """Go along a drive from sample ``k`` on; returns where it stopped and why."""
    while k < drive.size:
        if s.counts[DEPTH] + 2 > s.turn.size:
            return k, NO_ROOM
        lasts(t, s, time[k] - time[k - 1])
        out[k] = attempt(t, s, drive[k])
        if s.counts[TRY_BAD]:
            return k, BAD_SLOPE
        take(t, s, drive[k])
        k += 1
    return k, DONE


@numba.njit(cache=True)
def follow(t, s, time, target, low, high, slew, stay_low, stay_high, drive, k, reach):
    """Find the drive of a target from sample ``k`` on; returns where it stopped and why.

    Parameters
    ----------
    low, high, slew : the drive stays within V, and from sample to sample within V/s
    stay_low, stay_high : shapes (n,), where it waits, V, though the target goes on
    drive : shape (n,), written to
    reach : shape (2,), written to where a target is out of reach: what is within it, um
    """
    while k < target.size:
        if s.counts[DEPTH] + 2 > s.turn.size:
            return k, NO_ROOM
        step_s = time[k] - time[k - 1]
        lasts(t, s, step_s)
        before = s.scalars[DRIVE]
        least = max(low, before - slew * step_s)
        most = min(high, before + slew * step_s)
        found = _drive_to(t, s, target[k], least, most)
        if np.isnan(found):
            reach[0] = attempt(t, s, least)
            reach[1] = attempt(t, s, most)
            return k, OUT_OF_REACH
        found = min(max(found, min(stay_low[k], most)), max(stay_high[k], least))
        attempt(t, s, found)
        if s.counts[TRY_BAD]:
            return k, BAD_SLOPE
        take(t, s, found)
        drive[k] = found
        k += 1
    return k, DONE


@numba.njit(cache=True)
def _drive_to(t, s, target, least, most):
    """The drive within two bounds that moves the actuator to a target; NaN where there is none."""
    a = min(max(s.scalars[DRIVE], least), most)
    fa = attempt(t, s, a) - target
    if abs(fa) <= STAYS_UM:
        return a
    b = most if fa < 0.0 else least
    fb = attempt(t, s, b) - target
    if fb == 0.0:
        return b
    if (fa < 0.0) == (fb < 0.0):
        return b if abs(fb) <= MISSED_UM else np.nan
    # a straight line first, from the springs that hold where the actuator is; then the same from
    # the better end, halving what is left wherever that is slow (T. R. Chandrupatla, Adv. Eng.
    # Softw. 28 (1997) 145)
    start_v = a
    near = a + 1e-3 * (b - a)
    f_near = attempt(t, s, near) - target
    share = 0.5
    if f_near != fa:
        share = min(max(1e-3 * fa / (fa - f_near), 1e-6), 1.0)
    c, fc = a, fa
    for _ in range(TRIES):
        x = a + share * (b - a)
        fx = attempt(t, s, x) - target
        if (fx < 0.0) == (fa < 0.0):
            c, fc = a, fa
        else:
            c, fc = b, fb
            b, fb = a, fa
        a, fa = x, fx
        best = a if abs(fa) < abs(fb) else b
        if min(abs(fa), abs(fb)) <= EXACT_UM or abs(b - a) <= 1e-13 * max(1.0, abs(best)):
            break
        share = 0.5
        xi = (a - b) / (c - b) if c != b else 0.0
        phi = (fa - fb) / (fc - fb) if fc != fb else 0.0
        if fc != fa and phi * phi < xi and (1.0 - phi) * (1.0 - phi) < 1.0 - xi:
            share = fa / (fb - fa) * fc / (fb - fc)
            share += (c - a) / (b - a) * fa / (fc - fa) * fb / (fc - fb)
        elif fa != fb:
            straight = fa / (fa - fb)
            share = min(max(straight, 0.05), 0.95)
        tiny = 1e-13 * max(1.0, abs(best)) / abs(b - a)
        share = min(max(share, tiny), 1.0 - tiny)
    found = a if abs(fa) < abs(fb) else b
    return start_v if abs(found - start_v) < SMALLEST_V else found
