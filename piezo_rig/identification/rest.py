"""Whether a recording of unknown history begins with a first rise from rest.

A starting point says little: a steady loop that was cut at 0 V begins there too. What tells is
the first cycle. A loop that has settled comes back to where it was; a virgin first rise leaves
its curve behind for good. So the first rise is laid under the next one through the same drive,
and what lies between them is held against what lies between later ones (drift and noise lie
there always). What cannot be told, such as a loop that still grows and was cut at 0 V, is taken
for what it looks like.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import HalfLoops
from piezo_rig.chain.half_loops import noise

FloatArray = NDArray[np.float64]
LEFT = 0.005  # of the travel must be left behind
LEFT_AT_END = 0.01  # where it is seen at one drive only, not along a whole rise
TIMES = 3.0  # as much as later cycles differ by, or as noise would make
BINS = 16  # stretches of drive over which noise is averaged
LATER = 6  # rises that are compared
AMID = 0.1  # of the range, that a drive goes to either side of where it begins, not at rest
END = 0.03  # of the drive's range: this near to its start a line is laid


def begins_at_rest(
    drive: FloatArray, displacement: FloatArray, loops: HalfLoops, tolerance: float
) -> bool:
    """Whether the first half loop is a first rise (or fall) from rest.

    Parameters
    ----------
    drive, displacement : shape (n,), V and um
    loops : the drive's half loops
    tolerance : volts within which two drives are one
    """
    if len(loops) < 2:
        return False
    start = float(drive[0])
    if abs(start) > tolerance and (_amid(drive) or not _stayed(drive, loops, tolerance)):
        return False
    up = loops.direction[0] * (drive - start)  # volts from the start on, the first half loop up
    begin, end = up[loops.start], up[loops.stop]
    later = [k for k in range(2, len(loops), 2) if begin[k] <= tolerance < end[k]]
    if not later:
        return _left_at_end(up, displacement, loops, tolerance)
    for k in later:
        left = _left_behind(up, displacement, loops, [i for i in later if i >= k], tolerance)
        # a loop that grows may show nothing while it is small
        if left or end[k] <= end[0] + tolerance:
            return left
    return False


def _amid(drive: FloatArray) -> bool:
    """Whether the drive goes to both sides of where it begins: to get there it was moved."""
    sides = drive[0] - np.min(drive), np.max(drive) - drive[0]
    return bool(min(sides) > AMID * np.ptp(drive))


def _stayed(drive: FloatArray, loops: HalfLoops, tolerance: float) -> bool:
    """Whether the drive stays where it begins for as long as a usual half loop lasts."""
    stay = int(np.argmax(np.abs(drive - drive[0]) > tolerance))
    return stay > float(np.median(loops.stop[1:] - loops.start[1:]))


def _left_behind(
    up: FloatArray, displacement: FloatArray, loops: HalfLoops, later: list[int], tolerance: float
) -> bool:
    """Whether the first rise differs from the first of later ones as those do not differ."""
    stretch = [slice(int(a), int(b) + 1) for a, b in zip(loops.start, loops.stop, strict=True)]
    first, next_ = stretch[0], stretch[later[0]]
    top = min(float(up[first].max()), float(up[next_].max()))
    inside = (up[first] >= 0.0) & (up[first] <= top)
    at, under = up[first][inside], displacement[first][inside]
    bins = np.minimum((at / max(top, tolerance) * BINS).astype(int), BINS - 1)
    count = np.bincount(bins, minlength=BINS)
    filled = count > 0

    def above(k: int) -> FloatArray:
        """How far half loop k lies above the first rise, um, along the drive."""
        order = np.argsort(up[stretch[k]], kind="stable")
        other = np.interp(at, up[stretch[k]][order], displacement[stretch[k]][order])
        return np.bincount(bins, other - under, minlength=BINS)[filled] / count[filled]

    apart = above(later[0])
    begin, end = up[loops.start], up[loops.stop]
    alike = [
        k
        for k in later
        if abs(begin[k] - begin[later[0]]) <= tolerance and abs(end[k] - end[later[0]]) <= tolerance
    ][:LATER]
    usual, spread = np.zeros(apart.size), 0.0
    if len(alike) > 1:
        steps = np.diff([above(k) for k in alike], axis=0)
        usual = np.median(steps, axis=0)
        spread = float(np.sqrt(np.mean((steps - usual) ** 2)))
    travel = max(float(np.ptp(displacement[first])), float(np.ptp(displacement[next_])))
    slope = travel / max(float(np.ptp(up[first])), float(np.ptp(up[next_])))
    sigma = np.hypot(noise(displacement), slope * noise(up))
    by_noise = float(np.sqrt(np.mean(4.0 * sigma**2 / count[filled])))
    size = float(np.sqrt(np.mean((apart - usual) ** 2)))
    if size <= max(LEFT * travel, TIMES * spread, TIMES * by_noise):
        return False
    # A drive that dies away from a wider loop leaves something behind as well, but above its
    # first rise; through a drive of both signs a virgin first rise passes above its successors.
    dies_away = end[later[0]] < end[0] - tolerance and begin[later[0]] < -tolerance
    return not (dies_away and loops.direction[0] * apart[0] > 0)


def _left_at_end(
    up: FloatArray, displacement: FloatArray, loops: HalfLoops, tolerance: float
) -> bool:
    """The same where the drive only comes back to its start and does not rise from it again."""
    if float(up.min()) < -tolerance:
        return False  # it passes its start on the way down, where every loop is open
    back = np.flatnonzero((up[loops.stop] <= tolerance) & (loops.direction != loops.direction[0]))
    if not back.size:
        return False
    k = int(back[0])
    before, s1 = _at_start(up, displacement, loops, 0, tolerance)
    after, s2 = _at_start(up, displacement, loops, k, tolerance)
    # what the turning points in between drift by, each kind at its own drive
    length = float(loops.stop[k] - loops.start[0])
    drift, spread = 0.0, 0.0
    turns, before_that = loops.start[1 : k + 1], loops.start[:k]
    for first in (0, 1):
        kind, came_from = turns[first::2], before_that[first::2]
        # of turning points alike, and come to from alike: a drive at random has none
        same = [np.abs(up[x] - np.median(up[x])) <= tolerance for x in (kind, came_from) if x.size]
        here = kind[np.logical_and.reduce(same)] if same else kind
        if here.size < 2:
            continue
        line = np.polyfit(here, displacement[here], 1)
        drift = max(drift, float(line[0]) * length, key=abs)
        spread = max(spread, float(np.ptp(displacement[here] - np.polyval(line, here))))
    travel = float(np.ptp(displacement[: int(loops.stop[0]) + 1]))
    noisy = float(np.hypot(s1, s2))
    limit = max(LEFT_AT_END * travel, TIMES * spread, TIMES * noisy, 0.5 * abs(drift))
    return abs(after - before - drift) > limit


def _at_start(
    up: FloatArray, displacement: FloatArray, loops: HalfLoops, k: int, tolerance: float
) -> tuple[float, float]:
    """Displacement on half loop k where the drive is at its start, by a line; its deviation."""
    width = max(END * float(up.max()), 2.0 * tolerance)
    a, b = int(loops.start[k]), int(loops.stop[k]) + 1
    near = np.flatnonzero(up[a:b] <= width) + a
    x, y = up[near], displacement[near]
    if near.size < 4 or np.ptp(x) < 0.25 * width:
        return float(y[np.argmin(np.abs(x))]), noise(displacement)
    middle = x - x.mean()
    power = float(middle @ middle)
    deviation = noise(displacement) * float(np.sqrt(1.0 / x.size + x.mean() ** 2 / power))
    return float(y.mean() - (middle @ y) / power * x.mean()), deviation
