"""The one Maxwell / Prandtl-Ishlinskii kernel, compiled.

Everything that walks a drive sample by sample lives here. The module is
imported only when a walk is asked for, so that `--help` does not wait for
numba. It knows volts, distances and indices; what a spring or a law is, it
does not know.

A walk cuts the drive into *segments*: stretches on one band of one branch.
Displacement is continuous and its slope is constant on a segment, so a walk
is all that simulation (`fill`) and least squares need.

Memory follows Madelung's rules. The stack holds the turning points that are
still remembered, outermost first. The branch from the last of them ends at
the one before it (there both are forgotten, and the branch interrupted there
goes on), or, with one left, at its mirror image about the virgin drive (there
the initiation curve goes on).
"""

from __future__ import annotations

import numba
import numpy as np

# Columns of a walk's integer part: first sample, one past the last sample,
# band (< n0: initiation; else n0 + band of the later branch), half loop that
# the branch belongs to, +1 or -1 (the direction) where the band was entered
# over a break point, else 0.
# Float part: drive at the segment's beginning and end, first slope of its
# branch, distance from the branch's turning point at the beginning.
# Where only the displacement is asked for, a step of one sample over several
# bands is one segment: band LEAP, and for a slope the displacement in um.

LEAP = -1


# one by one: numpy's own ways to copy a part take seconds to compile


@numba.njit(cache=True, boundscheck=False, nogil=True)
def _longer(values):
    """Twice as long, zeros behind."""
    out = np.zeros(2 * values.size, values.dtype)
    for k in range(values.size):
        out[k] = values[k]
    return out


@numba.njit(cache=True, boundscheck=False, nogil=True)
def _longer_table(values):
    """Twice as many rows, zeros behind."""
    out = np.zeros((2 * values.shape[0], values.shape[1]), values.dtype)
    for k in range(values.shape[0]):
        for j in range(values.shape[1]):
            out[k, j] = values[k, j]
    return out


@numba.njit(cache=True, boundscheck=False, nogil=True)
def _run_end(v, i, up):
    """Last sample of the monotone run that contains i, moving up or down."""
    n = v.size
    # noise makes short runs: a few samples by themselves first
    for _ in range(6):
        if i + 1 == n or not (v[i + 1] >= v[i] if up else v[i + 1] <= v[i]):
            return i
        i += 1
    while True:
        if i + 65 <= n:
            # a view whose indices start at 0: the compiler turns this into vector code
            w = v[i : i + 65]
            good = 0
            if up:
                for k in range(64):
                    good += w[k + 1] >= w[k]
            else:
                for k in range(64):
                    good += w[k + 1] <= w[k]
            if good == 64:
                i += 64
                continue
        if i + 17 <= n:
            w = v[i : i + 17]
            good = 0
            if up:
                for k in range(16):
                    good += w[k + 1] >= w[k]
            else:
                for k in range(16):
                    good += w[k + 1] <= w[k]
            if good == 16:
                i += 16
                continue
        if up:
            while i + 1 < n and v[i + 1] >= v[i]:
                i += 1
        else:
            while i + 1 < n and v[i + 1] <= v[i]:
                i += 1
        return i


@numba.njit(cache=True, boundscheck=False, nogil=True)
def _first_beyond(v, i, end, limit, up):
    """First index in i..end whose drive lies beyond the limit; end + 1 if none."""
    if i > end or (v[end] <= limit if up else v[end] >= limit):
        return end + 1
    if end - i <= 12:
        while (v[i] <= limit) if up else (v[i] >= limit):
            i += 1
        return i
    # most drives are nearly straight between two events: guess, then bracket
    low = i - 1
    high = end
    rise = v[end] - v[i]
    guess = i + np.int64((limit - v[i]) / rise * (end - i)) if rise != 0.0 else i
    guess = min(max(guess, i), end)
    step = 1
    if (v[guess] <= limit) if up else (v[guess] >= limit):
        low = guess
        while low + step < high and ((v[low + step] <= limit) if up else (v[low + step] >= limit)):
            low += step
            step *= 2
        high = min(low + step, high)
    else:
        high = guess
        while high - step > low and ((v[high - step] > limit) if up else (v[high - step] < limit)):
            high -= step
            step *= 2
        low = max(high - step, low)
    while high - low > 1:
        mid = (low + high) >> 1
        if (v[mid] <= limit) if up else (v[mid] >= limit):
            low = mid
        else:
            high = mid
    return high


@numba.njit(cache=True, boundscheck=False, nogil=True)
def _back_again(v, i, here, room, up):
    """First sample beyond ``here`` after a small excursion the other way; -1 if there is none.

    Small: no further than ``room``, over within 24 samples.
    """
    end = min(i + 24, v.size)
    if up:
        while i < end and v[i] >= here and v[i] - here < room:
            i += 1
        return i if i < end and v[i] < here else -1
    while i < end and v[i] <= here and here - v[i] < room:
        i += 1
    return i if i < end and v[i] > here else -1


@numba.njit(cache=True, boundscheck=False, nogil=True)
def _leapt(distance, knots, slopes, rest_knots, rest_compliance, rest_moved):
    """Displacement of a branch after a distance from its turning point, and the band there.

    ``knots``, ``slopes`` : shape (e,), of its early bands; ``rest_moved`` : shape (r + 1,), um at
    the beginning of the bands after those
    """
    moved = 0.0
    begin = 0.0
    for b in range(knots.size):
        if distance < knots[b]:
            return moved + (distance - begin) / slopes[b], b
        moved += (knots[b] - begin) / slopes[b]
        begin = knots[b]
    distance -= begin
    low = 0
    high = rest_knots.size
    while low < high:
        middle = (low + high) >> 1
        if rest_knots[middle] <= distance:
            low = middle + 1
        else:
            high = middle
    before = rest_knots[low - 1] if low > 0 else 0.0
    moved += rest_moved[low] + (distance - before) * rest_compliance[low]
    return moved, knots.size + low


@numba.njit(cache=True, boundscheck=False, nogil=True)
def walk(
    v, origin, init_knots, early_knots, rest_knots, loop_start, early_slopes, keeps,
    rest_compliance, rest_moved,
):
    """Cut a drive into segments.

    Parameters
    ----------
    v : shape (n,), drive in volts
    origin : the virgin drive, volts
    init_knots : shape (n0 - 1,), |drive - origin| at the initiation curve's break points
    early_knots : shape (m, e), volts from the turning point to the end of each of the first
        bands of a branch that begins in that half loop (inf: never)
    rest_knots : shape (nc - e - 1,) or (0,), volts from the last of those to the other knots
    loop_start : shape (m,), first sample of every half loop
    early_slopes : shape (m, e), V/um on the first bands
    keeps : whether a loop that the drive closes exactly, and not beyond, is remembered
    rest_compliance, rest_moved : shape (nc - e,), um/V on the other bands and um where each begins;
        with them steps of one sample are leaps; shape (0,): no leaps

    Returns
    -------
    integers : shape (s, 5); floats : shape (s, 4); see the top of this module
    """
    n = v.size
    n0 = init_knots.size + 1
    n_early = early_knots.shape[1]
    n_rest = rest_knots.size
    capacity = 256
    ints = np.empty((capacity, 5), np.int64)
    floats = np.empty((capacity, 4), np.float64)
    count = 0
    room = 64
    turn = np.empty(room, np.float64)
    loop_of = np.empty(room, np.int64)
    band = np.zeros(room + 1, np.int64)  # band[0]: initiation; band[d]: branch of turn[d - 1]
    depth = 0
    loop = 0
    here = origin
    i = 0  # samples before i are covered
    end = -1  # last sample of the run before
    while i < n:
        start = end
        k = i
        resumed = False
        while k < n and v[k] == here:
            k += 1
        if k == n:
            up = True
            end = n - 1
        else:
            up = v[k] > here
            if count > 0:
                # a loop inside the first band is one line there and back: one segment, and
                # nothing of it is remembered
                of = loop
                while of + 1 < loop_start.size and loop_start[of + 1] <= start:
                    of += 1
                if depth == 0:
                    limit = 2.0 * origin - here
                else:
                    limit = turn[depth - 1]
                reach = min(early_knots[of, 0], abs(limit - here))
                after = _back_again(v, i, here, reach, up)
                if after >= 0 and (of + 1 == loop_start.size or loop_start[of + 1] >= after):
                    if count == capacity:
                        ints = _longer_table(ints)
                        floats = _longer_table(floats)
                        capacity *= 2
                    ints[count, 0] = i
                    ints[count, 1] = after
                    ints[count, 2] = n0
                    ints[count, 3] = of
                    ints[count, 4] = 0
                    floats[count, 0] = here
                    floats[count, 1] = here
                    floats[count, 2] = early_slopes[of, 0]
                    floats[count, 3] = 0.0
                    count += 1
                    loop = of
                    i = after
                    up = not up
                    resumed = True
                    k = i
            end = _run_end(v, k, up)
        if count > 0 and not resumed:
            while loop + 1 < loop_start.size and loop_start[loop + 1] <= start:
                loop += 1
            if depth + 2 > room:
                turn = _longer(turn)
                loop_of = _longer(loop_of)
                band = _longer(band)
                room *= 2
            turn[depth] = here
            loop_of[depth] = loop
            depth += 1
            band[depth] = 0
        sign = 1.0 if up else -1.0
        last = v[end]
        entered = 0
        if rest_moved.size > 0 and depth > 0 and i == end and band[depth] == 0:
            limit = turn[depth - 2] if depth > 1 else 2.0 * origin - turn[depth - 1]
            if turn[depth - 1] == here and (limit - last) * sign > 0.0:
                of = loop_of[depth - 1]
                moved, b = _leapt(
                    abs(last - here), early_knots[of], early_slopes[of], rest_knots,
                    rest_compliance, rest_moved,
                )
                if count == capacity:
                    ints = _longer_table(ints)
                    floats = _longer_table(floats)
                    capacity *= 2
                ints[count, 0] = i
                ints[count, 1] = end + 1
                ints[count, 2] = LEAP
                ints[count, 3] = of
                ints[count, 4] = 0
                floats[count, 0] = here
                floats[count, 1] = last
                floats[count, 2] = sign * moved
                floats[count, 3] = 0.0
                count += 1
                band[depth] = b
                here = last
                i = end + 1
                continue
        while True:
            b = band[depth]
            if depth == 0:
                reference = origin
                limit = sign * np.inf
                knot = init_knots[b] if b < n0 - 1 else np.inf
                branch_slope = 0.0
                branch_loop = 0
                code = b
            else:
                reference = turn[depth - 1]
                branch_loop = loop_of[depth - 1]
                branch_slope = early_slopes[branch_loop, 0]
                limit = turn[depth - 2] if depth > 1 else 2.0 * origin - reference
                if b < n_early:
                    knot = early_knots[branch_loop, b]
                elif b < n_early + n_rest:
                    knot = early_knots[branch_loop, n_early - 1] + rest_knots[b - n_early]
                else:
                    knot = np.inf
                code = n0 + b
            knot = reference + sign * knot
            returns = (limit - knot) * sign <= 0.0 or np.isinf(knot)
            stop = limit if returns else knot
            goes_on = (last - stop) * sign >= 0.0
            if keeps and returns and last == stop:
                goes_on = False
            if goes_on:
                after = _first_beyond(v, i, end, stop, up)
            else:
                stop = last
                after = end + 1
            if count == capacity:
                ints = _longer_table(ints)
                floats = _longer_table(floats)
                capacity *= 2
            ints[count, 0] = i
            ints[count, 1] = after
            ints[count, 2] = code
            ints[count, 3] = branch_loop
            ints[count, 4] = entered
            floats[count, 0] = here
            floats[count, 1] = stop
            floats[count, 2] = branch_slope
            floats[count, 3] = (here - reference) * sign
            count += 1
            here = stop
            i = after
            if not goes_on:
                break
            if returns:
                depth = depth - 2 if depth > 1 else 0
                entered = 0
                if last == stop:
                    break
            else:
                band[depth] += 1
                entered = 1 if up else -1
    return ints[:count], floats[:count]


@numba.njit(cache=True, boundscheck=False, nogil=True)
def fill(v, ints, floats, n0, init_compliance, early_slopes, rest_compliance, out):
    """Displacement of a walked drive into ``out``, um, shape (n,); 0 at the walk's origin."""
    y = 0.0
    n1 = n0 + early_slopes.shape[1]
    for s in range(ints.shape[0]):
        code = ints[s, 2]
        if code == LEAP:
            y += floats[s, 2]
            out[ints[s, 0]] = y
            continue
        if code < n0:
            c = init_compliance[code]
        elif code < n1:
            c = 1.0 / early_slopes[ints[s, 3], code - n0]
        else:
            c = rest_compliance[code - n1]
        begin = floats[s, 0]
        base = y - c * begin
        piece = out[ints[s, 0] : ints[s, 1]]
        drive = v[ints[s, 0] : ints[s, 1]]
        for k in range(drive.size):
            piece[k] = base + c * drive[k]
        y += c * (floats[s, 1] - begin)


@numba.njit(cache=True, boundscheck=False, nogil=True)
def moved_each(
    begins, v, init_knots, init_compliance, early_knots, early_slopes, rest_knots,
    rest_compliance, rest_moved, loop_start, loop_begins, keeps, out,
):
    """`walk` and `fill` of stretches that begin at these samples, each from a virgin start.

    ``loop_begins`` : of every stretch its first half loop; none where all are alike
    """
    for k in range(begins.size):
        a = begins[k]
        b = begins[k + 1] if k + 1 < begins.size else v.size
        c = 0
        d = loop_start.size
        first = 0
        if loop_begins.size:
            c = loop_begins[k]
            d = loop_begins[k + 1] if k + 1 < begins.size else loop_start.size
            first = a
        ints, floats = walk(
            v[a:b], v[a], init_knots, early_knots[c:d], rest_knots, loop_start[c:d] - first,
            early_slopes[c:d], keeps, rest_compliance, rest_moved,
        )
        fill(
            v[a:b], ints, floats, init_compliance.size, init_compliance, early_slopes[c:d],
            rest_compliance, out[a:b],
        )


@numba.njit(cache=True, boundscheck=False, nogil=True)
def turning_points(v, dead_band):
    """Samples at which the drive turns, ignoring reversals up to the dead band.

    The first entry is the first sample; the others are the extremes. Shape (m,).
    """
    n = v.size
    capacity = 64
    found = np.empty(capacity, np.int64)
    found[0] = 0
    count = 1
    high = low = 0
    direction = 0
    i = 1
    while i < n:
        if direction > 0:
            i = _run_end(v, i, True) if v[i] >= v[high] else i
        elif direction < 0:
            i = _run_end(v, i, False) if v[i] <= v[low] else i
        x = v[i]
        if direction >= 0 and x > v[high]:
            high = i
        if direction <= 0 and x < v[low]:
            low = i
        turned = -1
        if direction > 0 and v[high] - x > dead_band:
            turned = high
            direction = -1
            low = i
        elif direction < 0 and x - v[low] > dead_band:
            turned = low
            direction = 1
            high = i
        elif direction == 0 and x - v[low] > dead_band:
            direction = 1
            high = i
        elif direction == 0 and v[high] - x > dead_band:
            direction = -1
            low = i
        if turned > 0:
            if count == capacity:
                found = _longer(found)
                capacity *= 2
            found[count] = turned
            count += 1
        i += 1
    return found[:count]
