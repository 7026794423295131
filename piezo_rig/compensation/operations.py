"""What each operation does in one step, compiled: state before, signal in; state after, signal out.

A step is tried before it is taken, so nothing here writes to what was before. The formulas are
those of `piezo_rig.chain.relaxation`, `.oscillation` and `.backlash`, one sample at a time.
"""

from __future__ import annotations

import math

import numba

from piezo_rig.chain.given_back import DEEPEST, gained, is_back

SMALLEST_V = 1e-9  # what moves less stands still: it is the rounding of a solution
MEMORY = 52  # floats that an operation remembers at most: the stops of an asymmetry, and more
CREPT_AT, CREPT_FROM = MEMORY - 2, MEMORY - 1  # of a creep: where it is, where it began

# of `Operation`; compiled code reads plain numbers
GAIN, CLIP, SLEW, LAG, WIDEN, BEND, DRAG, RELAX, MODE, AGE, STOP = range(11)
BEND_DISPLACEMENT, BEND_DRIVE, GIVE_BACK, STRETCH = 11, 12, 13, 14
# of what is given back: displacement, turning points, its way, what it has beyond all of them,
# what it has; then where each turning point is and what was had there
DEPTH, WAY, BEYOND, HAS, TURNS = 1, 2, 3, 4, 5


@numba.njit(cache=True)
def begin(kind, n, new, x, drive):
    """The first sample of a virgin actuator: displacement or drive in, the same out."""
    for k in range(new.size):
        new[k] = 0.0
    if kind == GAIN:
        return n[0] * x + n[1]
    if kind == CLIP:
        return min(max(x, n[0]), n[1])
    if kind in (SLEW, LAG):
        new[0] = x
        new[1] = x
        return x
    if kind == DRAG and n[4] > 0.0:
        new[1] = drive
        return x
    if kind in (DRAG, WIDEN, STRETCH):
        for k in range(3 if kind != STRETCH else 3 + 2 * int(n[4])):
            new[k] = drive
        if kind == STRETCH:
            new[2] = 0.0
        return x
    if kind == BEND:
        return x + _bend(n, drive)
    if kind == RELAX:
        new[CREPT_FROM] = x
        return x
    if kind == MODE:
        new[3] = x
        return x
    if kind == AGE:
        new[0] = x
        new[1] = drive
        return x
    if kind == STOP:
        new[0] = x
        for k in range(int(n[3])):
            new[1 + k] = n[2] * n[4 + k]
        return _stop(n, new, new, x)
    if kind == BEND_DISPLACEMENT:
        return x + x * x * (n[0] + n[1] * x)
    if kind == BEND_DRIVE:
        return x + _bent_drive(n, x)
    if kind == GIVE_BACK:
        new[0] = x
        new[DEPTH] = 1.0
        new[TURNS] = x
        return x
    return x


@numba.njit(cache=True)
def prepare(kind, n, step_s, cache):
    """What depends on the length of the step alone."""
    if kind == SLEW:
        cache[0] = n[0] * step_s
    elif kind == LAG:
        _first_order(n[0], step_s, cache)
    elif kind in (DRAG, WIDEN, STRETCH):
        _first_order(n[2], step_s, cache)
        cache[2] = step_s
    elif kind == RELAX:
        m = int(n[0])
        for k in range(m):
            decay = math.exp(-step_s / n[1 + k])
            hold = n[1 + k] / step_s * (1.0 - decay)
            cache[k] = decay
            cache[m + k] = hold
    elif kind == MODE:
        omega, damping = n[1], n[2]
        ringing = omega * math.sqrt(1.0 - damping * damping)
        fade = math.exp(-damping * omega * step_s)
        cache[0] = fade * math.cos(ringing * step_s)
        cache[1] = fade * math.sin(ringing * step_s) / ringing
        cache[2] = step_s


@numba.njit(cache=True)
def _first_order(tau, step_s, cache):
    decay = math.exp(-step_s / tau)
    cache[0] = decay
    cache[1] = tau / step_s * (1.0 - decay)


@numba.njit(cache=True)
def step(kind, n, cap, cache, old, new, x, drive):
    """One step: ``x`` is the drive (operations on it) or the displacement so far."""
    if kind == GAIN:
        return n[0] * x + n[1]
    if kind == CLIP:
        return min(max(x, n[0]), n[1])
    if kind == BEND:
        return x + _bend(n, drive)
    if kind == SLEW:
        new[0] = _limited(old[0], old[1], x, cache[0])
        new[1] = x
        return new[0]
    if kind == LAG:
        return _follow(cache, old, new, x)
    if kind == DRAG and n[4] > 0.0:
        rate = (drive - old[1]) / cache[2] / n[3]
        drag = math.copysign(_drag(n, cap, rate), rate)
        new[0] = drag + (old[0] - drag) * cache[0]
        new[1] = drive
        return x - new[0]
    if kind == DRAG:
        rate = (drive - _follow(cache, old, new, drive)) / n[2] / n[3]
        return x - math.copysign(_drag(n, cap, rate), rate)
    if kind == RELAX:
        return x + _relax(n, cache, old, new, x)
    if kind == MODE:
        return x + n[0] * (_mode(n, cache, old, new, x) - x)
    if kind == AGE:
        return _age(n, cap, old, new, x, drive)
    if kind == STOP:
        return _stop(n, old, new, x)
    if kind == BEND_DISPLACEMENT:
        return x + x * x * (n[0] + n[1] * x)
    if kind == BEND_DRIVE:
        return x + _bent_drive(n, x)
    if kind == GIVE_BACK:
        return x + n[0] * _given_back(n[1], old, new, x)
    return x


@numba.njit(cache=True)
def widened(n, cap, cache, old, new, drive):
    """The drive that sliders see through thresholds that widen with its rate."""
    rate = (drive - _follow(cache, old, new, drive)) / n[2] / n[3]
    width = _drag(n, cap, rate)
    new[2] = min(max(old[2], drive - width), drive + width)
    return new[2]


@numba.njit(cache=True)
def stretched(n, cap, cache, old, new, drive):
    """What sliders add whose thresholds widen by a share.

    Memory: what the rate is taken from, the rate, every slider as it is, every one widened.
    """
    rate = (drive - _follow(cache, old, new, drive)) / n[2] / n[3]
    times, m, total = 1.0 + _drag(n, cap, rate), int(n[4]), 0.0
    turned, still = old[2] * rate < 0.0, drive
    if turned:
        moved = drive - old[1]
        share = n[2] / cache[2] * math.log1p(-old[2] * cache[2] * n[3] / moved)
        still = old[1] + moved * min(max(share, 0.0), 1.0)
    for k in range(m):
        r = n[5 + k]
        plain = min(max(old[3 + k], drive - r), drive + r)
        wide = old[3 + m + k]
        if turned:
            wide = min(max(wide, still - r), still + r)
        wide = min(max(wide, drive - times * r), drive + times * r)
        new[3 + k] = plain
        new[3 + m + k] = wide
        total += n[5 + m + k] * (wide - plain)
    new[2] = rate
    return total


@numba.njit(cache=True)
def _limited(out, before, x, most):
    """As far as it gets in a step towards a drive that goes straight, and may be met on the way."""
    gap, moved = before - out, x - before
    way = 1.0 if gap > 0.0 or (gap == 0.0 and moved > 0.0) else -1.0
    gap, moved = gap * way, moved * way
    if most - moved < gap:
        return out + way * most
    if moved >= -most:
        return x
    return out + way * most * (2.0 * gap / (most - moved) - 1.0)


@numba.njit(cache=True)
def _follow(cache, old, new, x):
    """A first-order lag: memory is its output and its input."""
    moved = x - old[1]
    new[0] = x - moved * cache[1] + (old[0] - old[1]) * cache[0]
    new[1] = x
    return new[0]


@numba.njit(cache=True)
def _drag(n, cap, rate):
    size = abs(rate)
    grown = size ** n[1] if n[1] >= 0.0 else math.log1p(-n[1] * size) / math.log1p(-n[1])
    return min(n[0] * grown, cap * size)


@numba.njit(cache=True)
def _bend(n, drive):
    u = (drive - n[0]) / n[1]
    return u * u * (n[2] + u * (n[3] + u * (n[4] + u * n[5])))


@numba.njit(cache=True)
def _bent_drive(n, drive):
    u = (drive - n[0]) / n[1]
    return u * (u - 1.0) * (n[2] + n[3] * u)


@numba.njit(cache=True)
def _relax(n, cache, old, new, x):
    m = int(n[0])
    here = x - old[CREPT_FROM]
    moved = here - old[CREPT_AT]
    total = 0.0
    for k in range(m):
        q = here - moved * cache[m + k] + (old[k] - old[CREPT_AT]) * cache[k]
        new[k] = q
        total += n[1 + m + k] * q
    new[CREPT_AT] = here
    new[CREPT_FROM] = old[CREPT_FROM]
    return total


@numba.njit(cache=True)
def _mode(n, cache, old, new, x):
    """Memory: how far the mode is off what it would follow, the rate of that, slope, input."""
    omega, damping, behind = n[1], n[2], n[3]
    slope = (x - old[3]) / cache[2]
    e = old[0] + behind * (slope - old[2])
    v = old[1] - (slope - old[2])
    new[0] = cache[0] * e + cache[1] * (v + damping * omega * e)
    new[1] = cache[0] * v - cache[1] * (omega * omega * e + damping * omega * v)
    new[2] = slope
    new[3] = x
    return x - behind * slope + new[0]


@numba.njit(cache=True)
def _age(n, band, old, new, x, drive):
    """Memory: displacement, extreme of the half loop, its way, those before it, what was added."""
    new[0] = x
    new[1] = old[1]
    new[2] = old[2]
    new[3] = old[3]
    on = (drive - old[1]) * old[2]
    if old[2] == 0.0:
        if abs(drive - old[1]) > band:
            new[1] = drive
            new[2] = 1.0 if drive > old[1] else -1.0
    elif on > 0.0:
        new[1] = drive
    elif on < -band:
        new[1] = drive
        new[2] = -old[2]
        new[3] = old[3] + 1.0
    cycles = new[3] // 2.0
    if n[1] > 0.0:  # over a decade they have grown by the rate
        grown = math.expm1(-cycles / n[1]) / math.expm1(-9.0 / n[1])
    else:
        grown = math.log10(cycles + 1.0)
    new[4] = old[4] + n[0] * grown * (x - old[0])
    return x + new[4]


@numba.njit(cache=True)
def _stop(n, old, new, x):
    """Memory: its input, the stops."""
    m = int(n[3])
    mean = most = 0.0
    for k in range(m):
        width = n[4 + k]
        new[1 + k] = min(max(old[1 + k] + x - old[0], -width), width)
        mean += new[1 + k] / m
        most += width / m
    new[0] = x
    return x - n[0] * (mean * mean / (2.0 * most) if n[1] > 0.0 else abs(mean))


@numba.njit(cache=True)
def _given_back(reach, old, new, x):
    """One sample of `piezo_rig.chain.given_back.given_back_each`."""
    depth, way = int(old[DEPTH]), old[WAY]
    for k in range(TURNS + 2 * depth):
        new[k] = old[k]
    step = x - old[0]
    if step * way < 0.0:
        if depth > DEEPEST - 1:
            depth -= 2
        new[TURNS + 2 * depth] = old[0]
        new[TURNS + 2 * depth + 1] = old[HAS]
        depth += 1
    if step != 0.0:
        way = 1.0 if step > 0.0 else -1.0
    while depth > 2 and is_back(x, new[TURNS + 2 * depth - 4], new[TURNS + 2 * depth - 2], way):
        depth -= 2
    if depth == 2 and is_back(x, new[TURNS], new[TURNS + 2], way):
        new[BEYOND] = new[TURNS + 1]
        new[TURNS] = new[TURNS + 2]
        new[TURNS + 1] = new[TURNS + 3]
        depth = 1
    has = new[BEYOND]
    if depth > 1:
        at = TURNS + 2 * (depth - 1)
        moved, whole = abs(x - new[at]), abs(new[at - 2] - new[at])
        back = new[at - 1] - new[at + 1]
        has = new[at + 1] + back * moved / whole + gained(moved, reach, whole)
    new[0] = x
    new[DEPTH] = depth
    new[WAY] = way
    new[HAS] = has
    return has
