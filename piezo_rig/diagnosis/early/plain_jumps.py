"""Jumps of the interferometer that are plain to see, for the actuator hardly moves there.

A base that is fitted to a recording with a jump in it follows as much of it as it can: over a
staircase it takes it for a step of the actuator, and what it leaves of it lies elsewhere. At its
instant it shows all the same, as a whole number of steps from one sample to the next.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezo_rig.diagnosis.early.mended import JUMP, STEP_UM, Break
from piezo_rig.diagnosis.early.peaks import Search
from piezo_rig.diagnosis.early.traces import Stretch, sweep_bounds

FloatArray = NDArray[np.float64]
WIDE = (4, 8)  # samples to either side, whose means are compared
STILL = 0.5  # of a jump, that the actuator may move by meanwhile
STANDS_OUT = 10.0  # times what such means usually differ by
OFF, WHOLE = 3.0, 0.25  # the same, and of a step, that a jump may be off a whole number of them
USUAL = 0.6745  # standard deviations that half of normal numbers stay within


def jumps_at_sight(search: Search) -> list[Break]:
    """Those of recordings of drives that were recorded once, in the order of time."""
    out = []
    for stretch in search.stretches:
        group = search.groups.groups[stretch.group]
        if group.repeats > 1:
            continue
        bounds = sweep_bounds(group, 0, search.sweeps)
        for at, count, deviations in _plain(search, stretch):
            end = next(b for a, b in bounds if a <= at < b)
            p = search.chance(0.5 * deviations**2)
            out.append(Break(JUMP, stretch.group, 0, at, count, at, at, end, p))
    return out


def _plain(search: Search, stretch: Stretch) -> list[tuple[int, int, float]]:
    """(first sample, steps, by how many standard deviations) of every one of a stretch."""
    cut = slice(stretch.begin, stretch.end)
    own = search.whole(stretch.group, 0)[cut]
    path = search.predicted[stretch.group][cut]
    widest = max(WIDE)
    if own.size < 100 * widest:
        return []
    seen = np.array([_changes(own, w) for w in WIDE])
    moved = np.full(own.size, np.inf)
    moved[widest : own.size - widest] = np.abs(path[2 * widest :] - path[: -2 * widest])
    usual = np.median(np.abs(seen - np.median(seen, axis=1, keepdims=True)), axis=1) / USUAL
    if not np.all(usual > 0.0) or np.any(OFF * usual > WHOLE * STEP_UM):
        return []
    count = np.rint(seen[0] / STEP_UM)
    plain = (count != 0.0) & (moved < STILL * np.abs(count) * STEP_UM)
    for change, deviation in zip(seen, usual, strict=True):
        plain &= np.abs(change - count * STEP_UM) < OFF * deviation
        plain &= np.abs(change) > STANDS_OUT * deviation
    out = list[tuple[int, int, float]]()
    for first in np.flatnonzero(plain):
        if out and first - out[-1][0] < widest:  # means of some samples show it at several
            if abs(seen[0, first]) > abs(seen[0, out[-1][0]]):
                out.pop()
            else:
                continue
        out.append((int(first), int(count[first]), abs(float(seen[0, first])) / float(usual[0])))
    return [(stretch.begin + at, steps, deviations) for at, steps, deviations in out]


def _changes(values: FloatArray, wide: int) -> FloatArray:
    """Mean of the next so many samples, from each on, less that of as many before it, (n,)."""
    total = np.cumsum(np.append(0.0, values))
    means = (total[wide:] - total[:-wide]) / wide
    out = np.zeros(values.size)
    out[wide : values.size - wide + 1] = means[wide:] - means[:-wide]
    return out
