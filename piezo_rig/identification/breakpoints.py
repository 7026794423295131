"""Where the break points are put: on grids, at equal displacements, or read off clean data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import half_loops
from piezo_rig.identification.data import Data, Track

FloatArray = NDArray[np.float64]
SAME = 1e-7  # of the reach: drive changes that differ by less are one level
# of the travel: as far from a line as rounding puts a sample, and data written with fewer digits
ROUNDED = (8e-13, 1e-10, 1e-8, 1e-7, 1e-6, 1e-5)
MOST_LINES = 400
MOST_TURNS = 20_000


def equal_volts(reach_v: float, n: int) -> FloatArray:
    """n - 1 break points that cut 0..reach into n equal pieces."""
    return reach_v * np.arange(1.0, n) / n


def equal_travel(
    knots: FloatArray, compliance: FloatArray, reach_v: float, dx: float
) -> FloatArray:
    """Drives at which a curve has travelled dx, 2 dx, ... below its reach.

    This is the thesis's spacing: elements give way at equal steps of displacement.
    """
    drive = np.concatenate([[0.0], knots[knots < reach_v], [reach_v]])
    c = compliance[: drive.size - 1]
    travel = np.concatenate([[0.0], np.cumsum(c * np.diff(drive))])
    steps = dx * np.arange(1.0, int(np.ceil(travel[-1] / dx - 1e-9)))
    return np.interp(steps, travel, drive)


@dataclass(frozen=True, eq=False)
class BreakPoints:
    """Volts since the beginning of a half loop; empty where unknown.

    Attributes
    ----------
    first, later : of the first rise, and of a later branch
    sure : every line has three points or more, and crosses its neighbours between points
    """

    first: FloatArray
    later: FloatArray
    sure: bool


def read_off(data: Data, sigma_um: float, kind: str, straight: bool = False) -> BreakPoints:
    """Break points of clean, piecewise linear data: of the first rise, and of a later branch.

    Every sample of every half loop lies on a curve that starts at a turning point. Taken together
    they show it at all drive changes that the recording has anywhere, so that a growing amplitude
    or few samples a cycle are enough. Lines are drawn through as many neighbouring points as lie
    on one; break points are where neighbours cross, or a point between two that do not.

    Parameters
    ----------
    kind : ``one`` curve for the first rise and, at twice the size, later branches; ``two``
        curves; or later branches by a ``law``, of which the longest one is read
    straight : break points are at the points between which lines cross
    """
    first, later = _points(data, kind)
    if kind == "one":
        rises = [(2.0 * x, 2.0 * y) for x, y in first]
        both, sure = _broken_line([*later, *rises], sigma_um, straight)
        return BreakPoints(both / 2.0, both, sure)
    if kind == "law":
        first, later = first[:1], later[:1]
    rise, one = _broken_line(first, sigma_um, straight)
    branch, other = _broken_line(later, sigma_um, straight)
    return BreakPoints(rise, branch, one and other)


Points = list[tuple[FloatArray, FloatArray]]


def _points(data: Data, kind: str) -> tuple[Points, Points]:
    """Drive and displacement since the turning point, of first rises and of later branches.

    Longest first. What a half loop resumes counts where loops close: with one curve on all, with
    two on later branches.
    """
    found: tuple[Points, Points] = ([], [])
    for track in data.tracks:
        for ref, begin, end, rise, resumed in _stretches(track):
            closes = kind == "one" or (kind == "two" and not rise)
            if (rise and not track.virgin) or (resumed and not closes):
                continue
            if not any(a <= ref and end <= b for a, b in track.blocks):
                continue
            part = slice(begin, end)
            x = np.abs(track.drive_v[part] - track.drive_v[ref])
            y = np.abs(track.displacement_um[part] - track.displacement_um[ref])
            found[0 if rise else 1].append((x, y))
    for parts in found:
        parts.sort(key=lambda p: -round(float(p[0][-1]), 9))
    return found


def _stretches(track: Track) -> Iterator[tuple[int, int, int, bool, bool]]:
    """Samples begin..end on one curve from sample ``ref``; a first rise? one that is resumed?"""
    v = track.drive_v
    turns = half_loops(v, 0.0).start
    if turns.size > MOST_TURNS:
        return
    memory: list[int] = []
    for k, (a, b) in enumerate(pairwise([*(int(t) for t in turns), v.size - 1])):
        if k:
            memory.append(a)
        up = v[b] > v[a]
        run = v[a : b + 1] if up else -v[a : b + 1]
        done, resumed = 0, False
        while True:
            ref = memory[-1] if memory else 0
            limit = np.inf
            if memory:
                limit = v[memory[-2]] if len(memory) > 1 else 2.0 * v[0] - v[ref]
                limit = limit if up else -limit
            upto = int(np.searchsorted(run, limit, side="right"))
            if upto > done:
                yield ref, a + done, a + upto, not memory, resumed
            done, resumed = max(done, upto), True
            if run[-1] < limit:
                break
            del memory[-2:]
            if done >= run.size:
                break


def _broken_line(parts: Points, sigma: float, straight: bool) -> tuple[FloatArray, bool]:
    """Break points of the line on which all points (volts, um) lie; are they sure?"""
    if not parts:
        return np.empty(0), True
    x = np.concatenate([np.zeros(1), *(p[0] for p in parts)])
    y = np.concatenate([np.zeros(1), *(p[1] for p in parts)])
    order = np.argsort(x, kind="stable")
    x, y = x[order], y[order]
    group = np.cumsum(np.diff(x, prepend=x[0]) > SAME * x[-1])
    count = np.bincount(group)
    x, y = np.bincount(group, x) / count, np.bincount(group, y) / count
    lines: list[tuple[int, int]] = []
    for share in ROUNDED:
        tried = _lines(x, y, max(8.0 * sigma, share * float(np.ptp(y))))
        # what was rounded is cut to pieces by a tolerance that is too small
        if not lines or 3 * len(lines) > x.size or 2 * len(tried) <= len(lines):
            lines = tried
    return _crossings(x, y, lines, straight)


def _lines(x: FloatArray, y: FloatArray, tolerance: float) -> list[tuple[int, int]]:
    """Runs of points (first, one past last) on a line each; none where there are too many."""

    def fits(i: int, j: int) -> bool:
        slope, level = _line(x[i:j], y[i:j])
        return bool(np.max(np.abs(level + slope * x[i:j] - y[i:j])) <= tolerance)

    out: list[tuple[int, int]] = []
    i = 0
    while i < x.size:
        good, step = min(i + 2, x.size), 1
        while good < x.size and fits(i, min(good + step, x.size)):
            good, step = min(good + step, x.size), 2 * step
        bad = min(good + step, x.size + 1)
        while bad - good > 1:
            middle = (good + bad) // 2
            good, bad = (middle, bad) if fits(i, middle) else (good, middle)
        out.append((i, good))
        i = good
        if len(out) > MOST_LINES:
            return []
    return out


def _line(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Slope and level at 0 of the line through points."""
    centre, height = float(x.mean()), float(y.mean())
    u = x - centre
    power = float(u @ u)
    slope = float(u @ (y - height)) / power if power > 0 else 0.0
    return slope, height - slope * centre


def _crossings(
    x: FloatArray, y: FloatArray, lines: list[tuple[int, int]], straight: bool
) -> tuple[FloatArray, bool]:
    """Where neighbouring lines cross, or both points between them where they do not cross there."""
    knots: list[float] = []
    sure = True
    for (a, b), (_, d) in pairwise(lines):
        left, right = float(x[b - 1]), float(x[b])
        if d - b < 2:  # one point is left over at the end
            knots.append(left if straight else 0.5 * (left + right))
            sure = False
            continue
        (s, c), (s2, c2) = _line(x[a:b], y[a:b]), _line(x[b:d], y[b:d])
        at = (c - c2) / (s2 - s) if s2 != s else np.inf
        room = 1e-3 * (right - left)
        crossing = bool(left - room <= at <= right + room)
        known = crossing and min(b - a, d - b) > 2
        sure = sure and known
        knots += [left, right] if straight or not crossing else [float(at)]
    found = np.unique(np.array(knots))
    gap = 1e-6 * x[-1]
    found = found[(found > gap) & (found < x[-1] - gap)]
    return found[np.diff(found, prepend=-np.inf) > gap], sure
