"""Lines in clock time that are not the mains': vibration of the floor, a fan, a beating clock.

No cause of the catalogue, so at most "unexplained"; sought like hum, in what repeats disagree by,
at every frequency.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezo_rig.chain import Model
from piezo_rig.diagnosis.chances import chi2_above
from piezo_rig.diagnosis.early.hum import AROUND, INDEPENDENT, rows_of
from piezo_rig.diagnosis.groups import Groups

CELLS = 18.0  # resolution cells: slower than that a line is drift or creep


@dataclass(frozen=True)
class Line:
    """The strongest line: Hz, rms in nm, and its chance among all frequencies."""

    frequency: float
    rms_nm: float
    p_value: float


def find_line(groups: Groups, model: Model) -> Line | None:
    """The most unlikely line between the slow end and nine tenths of Nyquist.

    Only with repeats: against a model, every harmonic of the drive would be one.
    """
    if any(g.repeats < 2 for g in groups.groups):
        return None
    rows = rows_of(groups, model)
    longest = max(float(r.time_s[-1] - r.time_s[0]) for r in rows)
    low, high = CELLS / longest, 0.45 * groups.rate
    if low >= 0.5 * high:
        return None
    f = np.arange(low, high, 0.5 / longest)
    score, share = np.zeros(f.size), np.zeros(f.size)
    power, heard = np.zeros(f.size), np.zeros(f.size)
    for row in rows:
        cell = 1.0 / float(row.time_s[-1] - row.time_s[0])
        told = f >= CELLS * cell  # a short recording says nothing of slow lines
        level = row.power(f[told, None] + AROUND * cell).mean(axis=1)
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
    k = int(np.argmin(chance))
    if not told[k]:
        return None
    rms = float(np.sqrt(0.5 * power[k] / heard[k]))
    return Line(float(f[k]), 1e3 * rms, min(float(chance[k]) * f.size, 1.0))
