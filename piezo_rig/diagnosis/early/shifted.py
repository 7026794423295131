"""Lost samples that are plain to see: from some sample on one recording runs ahead of the others.

Where the drive never repeats itself, what a loss does looks like loud noise, and a search that
measures the noise first finds nothing. Here the recordings are laid over each other, shifted by
so many samples from some sample on, and no noise has to be known: a shift that takes off a good
part of the difference between them is no accident. What differs by much counts no more than what
differs by a little less, so that other losses do not disturb.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.diagnosis.early.mended import DROP, Break, lead
from piezo_rig.diagnosis.early.traces import EXACT, comparable_from, sweep_bounds
from piezo_rig.diagnosis.groups import Group
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]
MOST = 200  # samples that may be lost
PLAINLY = 0.2  # of the difference that a shift must take off
CHUNKS, UNSTEADY = 16, 6.0  # parts of a sweep, and how unlike their variances must be
LOUD = 25.0  # times the variance of the quietest part: more counts for no more
WORTH = 0.1  # of what the best shift takes off: the earliest of so much comes first
BESIDE = 0.005  # of a sweep: shifts from there on are of one loss
DOUBT = 12.0  # variances by which another sample must be worse
TINY = 1e-18  # um^2


@dataclass(frozen=True)
class Shift:
    """One recording ahead of the others for a while.

    Attributes
    ----------
    off : share of the difference that it takes off
    index, low, high : the first sample, and where that may be as well
    count : samples by which it is ahead
    """

    off: float
    index: int
    low: int
    high: int
    count: int


def plain_loss(
    group: Group, g: int, sweeps: Sequence[Sweep], breaks: Sequence[Break]
) -> Break | None:
    """The first of the losses that explain most of what recordings of one drive differ by.

    ``group`` : mended of all ``breaks``
    """
    found, known = [], comparable_from(group)
    for row in range(group.repeats if group.repeats > 1 else 0):
        others = np.delete(group.measured_um, row, axis=0).mean(axis=0)
        for begin, end in sweep_bounds(group, row, sweeps):
            begin = max(begin, min(known, end))
            cut = slice(begin, end)
            found += [(s, row, begin, end) for s in shifts(group.measured_um[row, cut],
                                                           others[cut])]  # fmt: skip
    if not found or max(s.off for s, *_ in found) < PLAINLY:
        return None
    most = max(s.off for s, *_ in found)
    first = min((s for s, *_ in found if s.off > WORTH * most), key=lambda s: s.index)
    until = max(first.high, first.index + BESIDE * group.drive_v.size)
    seen, row, begin, end = max(
        (f for f in found if f[0].index <= until), key=lambda f: f[0].off
    )
    before = lead(breaks, g, row, begin + seen.index)
    index, low, high = (begin - before + i for i in (seen.index, seen.low, seen.high))
    return Break(DROP, g, row, index, seen.count, low, high, end, 1.0)


def differing(group: Group) -> float:
    """Mean square (um^2) by which recordings of one drive differ, where they should not."""
    rows = group.measured_um[:, comparable_from(group) :]
    rows = rows - rows.mean(axis=0)
    return float(rows.var(axis=1).mean())


def shifts(row: FloatArray, others: FloatArray) -> list[Shift]:
    """What every shift of a recording (n,) against others of the same takes off at best."""
    n = row.size
    parts = np.array_split(row - others, CHUNKS)
    power = [float(p.var()) for p in parts]
    # holds of a coarse sensor, and copies, do not differ at all
    quiet = max(min(power), (EXACT * float(np.ptp(others))) ** 2, TINY)
    if n < 4 * CHUNKS or max(power) < UNSTEADY * quiet:
        return []
    row = row - float(np.median(parts[int(np.argmin(power))]))
    plain = np.minimum((row - others) ** 2, LOUD * quiet)
    out = []
    for count in range(1, min(MOST, n // 4) + 1):
        m = n - count
        ahead = np.minimum((row[:m] - others[count:]) ** 2, LOUD * quiet)
        # the stretch over which it takes off most (Kadane)
        taken = np.append(0.0, np.cumsum(plain[:m] - ahead))
        end = int(np.argmax(taken - np.minimum.accumulate(taken)))
        begin = int(np.argmin(taken[: end + 1]))
        near = np.flatnonzero(taken[: end + 1] <= taken[begin] + DOUBT * quiet)
        out.append(Shift(
            float(taken[end] - taken[begin]) / max(float(plain.sum()), 1e-300),
            begin, _first_of_run(near, begin), _last_of_run(near, begin), count,
        ))  # fmt: skip
    return out


def _first_of_run(near: NDArray[np.int64], at: int) -> int:
    """The first sample from which on all up to ``at`` are among ``near``."""
    k = int(np.searchsorted(near, at))
    while k > 0 and near[k - 1] == near[k] - 1:
        k -= 1
    return int(near[k])


def _last_of_run(near: NDArray[np.int64], at: int) -> int:
    k = int(np.searchsorted(near, at))
    while k + 1 < near.size and near[k + 1] == near[k] + 1:
        k += 1
    return int(near[k])
