"""Recordings with their breaks mended: steps taken out, what follows lost samples moved back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes.fringe_jump import STEP_NM
from piezo_rig.diagnosis.groups import Groups

FloatArray = NDArray[np.float64]
JUMP, DROP = "fringe-jump", "dropped-samples"
STEP_UM = 1e-3 * STEP_NM


@dataclass(frozen=True)
class Break:
    """One break of one recording.

    Attributes
    ----------
    cause : ``fringe-jump`` or ``dropped-samples``
    group, row : the recording
    index : first sample of the record behind the break
    count : steps of lambda/8, or samples that are missing
    low, high : where it may be as well; what lies between is not used
    end : one past the last sample of the sweep
    p_value : chance of it anywhere in the data
    sure : whether the drive monitor has shown it: its place and count stand
    """

    cause: str
    group: int
    row: int
    index: int
    count: int
    low: int
    high: int
    end: int
    p_value: float
    sure: bool = False


def mended(groups: Groups, predicted: Sequence[FloatArray], breaks: Sequence[Break]) -> Groups:
    """The recordings without the breaks; gaps follow the prediction (n,) of each group."""
    out = []
    for g, group in enumerate(groups.groups):
        rows = group.measured_um.copy()
        for r in range(group.repeats):
            mine = [b for b in breaks if (b.group, b.row) == (g, r)]
            if mine:
                rows[r] = moved(rows[r], predicted[g], mine)
        out.append(group.with_measured(rows) if any(b.group == g for b in breaks) else group)
    return groups.with_(out)


def moved(row: FloatArray, predicted: FloatArray, breaks: Sequence[Break]) -> FloatArray:
    """One record (n,) without its breaks; gaps follow what is predicted (n,)."""
    level, at, known = row.copy(), np.arange(row.size), np.ones(row.size, bool)
    ends = np.full(row.size, row.size)
    for b in breaks:
        known[b.low : b.high] = False
        if b.cause == JUMP:
            level[b.index : b.end] -= b.count * STEP_UM
        else:
            at[b.index : b.end] += b.count
            ends[b.index : b.end] = b.end
    known &= at < ends
    off = np.full(row.size, np.nan)
    off[at[known]] = level[known] - predicted[at[known]]
    good = np.flatnonzero(np.isfinite(off))
    return predicted + np.interp(np.arange(row.size), good, off[good])


def lead(breaks: Sequence[Break], group: int, row: int, index: int) -> int:
    """Samples missing before a sample of a mended record, within its sweep."""
    total = 0
    for b in sorted(breaks, key=lambda b: b.index):
        if (b.cause, b.group, b.row) == (DROP, group, row) and (
            b.index + total <= index and index < b.end
        ):  # fmt: skip
            total += b.count
    return total
