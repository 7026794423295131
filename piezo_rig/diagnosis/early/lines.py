"""Lines in clock time that are not the mains': vibration of the floor, a fan, a beating clock.

No cause of the catalogue, so at most "unexplained"; sought like hum, in what repeats disagree by,
at every frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.diagnosis.chances import chi2_above
from piezo_rig.diagnosis.early.hum import AROUND, INDEPENDENT, Row, rows_of
from piezo_rig.diagnosis.groups import Groups

FloatArray = NDArray[np.float64]
BESIDE, FAR = 4.0, 8.0  # cells of a line's own width; of the power of what is next
CELLS = 18.0  # resolution cells: slower than that, drift and creep are beside a line
SLOWEST = 7.0  # the same: slower than that a line is drift or creep


@dataclass(frozen=True)
class Line:
    """The strongest line: Hz, rms in nm, and its chance among all frequencies."""

    frequency: float
    rms_nm: float
    p_value: float


@dataclass(frozen=True, eq=False)
class Spectrum:
    """What rows have at every frequency.

    Attributes
    ----------
    f : shape (k,)
    chance : shape (k,), of each by itself; 1 where no row is long enough
    power : shape (k,), squared peak amplitude, mean over rows that are long enough
    told, slow : shape (k,), whether one is; whether lines are slow there
    cell : resolution of the longest row
    """

    f: FloatArray
    chance: FloatArray
    power: FloatArray
    told: NDArray[np.bool_]
    slow: NDArray[np.bool_]
    cell: float

    def likeliest(self, some: NDArray[np.bool_]) -> int:
        return int(np.argmin(np.where(some, self.chance, np.inf)))

    def alone(
        self, k: int, power: FloatArray, among: NDArray[np.bool_], far: float = FAR
    ) -> bool:
        """Whether a line is far above all others of some that are not its neighbours."""
        beside = among & (np.abs(self.f - self.f[k]) > BESIDE * self.cell)
        return bool(beside.any()) and bool(power[k] >= far * float(power[beside].max()))


def spectrum_of(rows: Sequence[Row], high: float) -> Spectrum | None:
    """From the slow end up to a frequency; None where the rows are too short for it."""
    longest = max(float(r.time_s[-1] - r.time_s[0]) for r in rows)
    low = SLOWEST / longest
    if low >= 0.5 * high:
        return None
    f = np.arange(low, high, 0.5 / longest)
    slow = f < CELLS / longest
    score, share = np.zeros(f.size), np.zeros(f.size)
    power, heard = np.zeros(f.size), np.zeros(f.size)
    for row in rows:
        cell = 1.0 / float(row.time_s[-1] - row.time_s[0])
        # a short recording says nothing of slow lines, and none of what its own drive does
        told = (f >= np.where(slow, SLOWEST, CELLS) * cell) & ~row.near_first_line(f)
        level = _background(row, f[told], cell)
        # each recording's own p-value (Fisher): power over background is F(2, 2 INDEPENDENT)
        own = row.power(f[told])
        score[told] += row.share * INDEPENDENT * np.log1p(
            own / np.maximum(level, 1e-300) / INDEPENDENT
        )
        share[told] += row.share
        power[told] += own / row.share
        heard[told] += 1.0
    chance = np.ones(f.size)
    told = heard > 0
    chance[told] = chi2_above(2.0 * score[told], 2.0 * share[told])
    return Spectrum(f, chance, power / np.maximum(heard, 1.0), told, slow, 1.0 / longest)


def find_line(groups: Groups, model: Model) -> Line | None:
    """The most unlikely line between the slow end and nine tenths of Nyquist.

    With repeats in what they disagree by. Against a model every harmonic of the drive is one, so
    there it must stand alone, and far above the second strongest. So it must where it is slow: what
    recordings differ by goes with the drive there, and noise grows towards the slow end.
    """
    lone = any(g.repeats < 2 for g in groups.groups)
    rows = rows_of(groups, model)
    if not rows or (lone and groups.repeats > 1):  # of some drives only
        return None
    found = spectrum_of(rows, 0.45 * groups.rate)
    if found is None:
        return None
    longest_row = max(rows, key=lambda r: r.values.size)
    seen = longest_row.power(found.f) if lone else found.power
    fast, slow = found.told & ~found.slow, found.told & found.slow
    standing = list[int]()
    for some, among, freely in ((fast, fast, not lone), (slow, found.told, False)):
        if some.any():
            k = found.likeliest(some)
            if freely or (
                found.alone(k, seen, among)
                and _not_played(groups, model, float(found.f[k]), float(seen[k]))
            ):
                standing.append(k)
    if not standing:
        return None
    k = min(standing, key=lambda k: float(found.chance[k]))
    rms = float(np.sqrt(0.5 * found.power[k]))
    plainest = max(rows, key=lambda r: float(r.power(found.f[k])))
    chance = min(float(found.chance[k]) * found.f.size, 1.0)
    return Line(summit(plainest, float(found.f[k])), 1e3 * rms, chance)


def summit(row: Row, near_hz: float) -> float:
    """Where a line is strongest near a frequency, Hz."""
    cell = 1.0 / float(row.time_s[-1] - row.time_s[0])
    f = near_hz + np.linspace(-1.0, 1.0, 41) * cell
    return float(f[int(np.argmax(row.power(f)))])


def _background(row: Row, f: FloatArray, cell: float) -> FloatArray:
    """Mean power around frequencies (k,), um^2; of slow ones that above them alone, as it would be
    there if it grew with the square of the period towards them.
    """
    level = row.power(f[:, None] + AROUND * cell).mean(axis=1)
    slow = f < CELLS * cell
    above = f[slow, None] + AROUND[AROUND > 0] * cell
    level[slow] = (row.power(above) * np.square(above / f[slow, None])).mean(axis=1)
    return np.asarray(level)


def _not_played(groups: Groups, model: Model, line_hz: float, power: float) -> bool:
    """Whether no line is there in the longest drive, nor in what it does, or a lesser one: a model
    is not wrong by more than all of it.

    ``power`` : of what the model leaves there, um^2
    """
    group = max(groups.groups, key=lambda g: g.drive_v.size)
    cell = 1.0 / float(group.time_s[-1] - group.time_s[0])
    predicted = group.predicted(model)
    um_per_v = float(np.ptp(predicted)) / max(float(np.ptp(group.drive_v)), 1e-300)
    around = line_hz + AROUND * cell
    for signal in (um_per_v * group.drive_v, predicted):
        played = Row(group.time_s, signal, 1.0)
        there = played.power(line_hz)
        if there > power and there >= FAR * float(np.mean(played.power(around[around > 0.0]))):
            return False
    return True
