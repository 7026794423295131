"""Losses that are guessed where none fits alone, for both recordings of a drive have lost some, and
jumps that are counted at sight.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from piezo_rig.diagnosis.early.mended import DROP, STEP_UM, Break, lead
from piezo_rig.diagnosis.early.peaks import GRID, Peak, Search, find_pair
from piezo_rig.diagnosis.early.place import placed
from piezo_rig.diagnosis.early.traces import sweep_bounds

BESIDE = 12  # samples to either side, that say how large a jump is
CLEAR = 12.0  # log-likelihood that an instant itself must be worth


def losses_of_pairs(search: Search, g: int, level: float) -> list[Peak]:
    """Losses in both of two recordings of one drive, the first of each pair."""
    if search.groups.groups[g].repeats != 2:
        return []
    peaks = [find_pair(search, k) for k, s in enumerate(search.stretches) if s.group == g]
    return [p for p in peaks if p is not None and search.chance(p.gained) < level / GRID]


def guess_of(search: Search, peaks: Sequence[Peak]) -> Break | None:
    """One lost sample at an instant that is plain to see, though its size is no whole number.

    Where each of two recordings of a drive has lost some, neither loss fits as long as the other is
    there. Whether it was right shows when others have been found beside it.
    """
    best: tuple[float, Break] | None = None
    for peak in peaks:
        stretch = search.stretches[peak.stretch]
        group, model = search.groups.groups[stretch.group], search.predicted[stretch.group]
        if peak.cause != DROP or group.repeats < 2:
            continue
        near = placed(search.whole(stretch.group, peak.row), model, DROP, peak.at, 1, stretch)
        if near is None or near[3] < CLEAR or (best is not None and near[3] <= best[0]):
            continue
        before = lead(search.breaks, stretch.group, peak.row, near[0])
        end = next(
            b for a, b in sweep_bounds(group, peak.row, search.sweeps) if a <= near[0] < b
        )
        index, low, high = (i - before for i in near[:3])
        p = search.chance(near[3])
        best = near[3], Break(DROP, stretch.group, peak.row, index, 1, low, high, end, p)
    return None if best is None else best[1]


def at_sight(search: Search, peak: Peak) -> int:
    """Steps between what a recording has of its own before and after a jump.

    Noise is measured with the jump in it: of a large one it hides most, where it falls into the
    middle of an averaged sample.
    """
    stretch = search.stretches[peak.stretch]
    own = search.whole(stretch.group, peak.row)
    before = own[max(peak.at - stretch.factor - BESIDE, stretch.begin) : peak.at - stretch.factor]
    after = own[peak.at + stretch.factor + 1 : min(peak.at + stretch.factor + BESIDE, stretch.end)]
    if not (before.size and after.size):
        return 0
    return int(np.rint((np.median(after) - np.median(before)) / STEP_UM))
