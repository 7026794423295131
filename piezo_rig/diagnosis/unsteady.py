"""Whether recordings of one drive differ by a share of the displacement: a gain that is not steady.

What repeats disagree by is taken for noise. Noise knows nothing of where the actuator stands; what
follows the displacement, more in one recording or one cycle than in another, is no noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.diagnosis.chances import chi2_above
from piezo_rig.diagnosis.groups import Group, Groups
from piezo_rig.diagnosis.whitening import CellWhitener

FloatArray = NDArray[np.float64]
PARTS = 12  # of a recording, at most, each with a gain of its own
LITTLE = 1e-6  # of the longest column, squared


@dataclass(frozen=True)
class Unsteady:
    """``share`` of the displacement (rms), and its ``rms_nm``, by which recordings differ."""

    p_value: float
    share: float
    rms_nm: float


def unsteady(groups: Groups, whitener: CellWhitener, model: Model) -> Unsteady | None:
    """How far a gain changes between repeats and along them; None without repeats.

    Deviations from the mean of a drive's recordings are fitted by the displacement, recording by
    recording, and part by part of each; of the two the likelier counts, twice.
    """
    if not any(g.repeats > 1 for g in groups.groups):
        return None
    found = [_by_parts(groups, whitener, model, parts) for parts in (1, PARTS)]
    return min(found, key=lambda u: u.p_value)


def _by_parts(groups: Groups, whitener: CellWhitener, model: Model, parts: int) -> Unsteady:
    chi2 = freedom = power = square = samples = 0.0
    for group in groups.groups:
        if group.repeats < 2:
            continue
        left = group.at_one_time(model).measured_um
        left = groups.thinned(group, left - left.mean(axis=0))
        moved = groups.thinned(group, _parts_of(group, model, parts))
        for (a, b), cells in zip(groups.edges(group), groups.cells(group), strict=True):
            one = whitener.ones(cells)
            columns, rows = (
                white - np.outer(white @ one / float(one @ one), one)
                for white in (whitener(y[:, a:b], cells) for y in (moved, left))
            )
            gram = columns @ columns.T
            kept = np.flatnonzero(np.diag(gram) > LITTLE * np.diag(gram).max())
            gram = gram[np.ix_(kept, kept)]
            gains = np.linalg.solve(gram, columns[kept] @ rows.T)  # a column per recording
            chi2 += float(np.sum(gains * (gram @ gains)))
            freedom += float(kept.size * (group.repeats - 1))
            lengths = np.sum(cells.centred(moved[kept, a:b]) ** 2, axis=1)
            power += float(lengths @ np.sum(gains**2, axis=1))
            square += group.repeats * float(lengths.sum())
            samples += group.repeats * float(cells.share.sum())
    real = max(1.0 - freedom / max(chi2, 1e-300), 0.0)  # not what noise alone would make
    return Unsteady(
        min(2.0 * float(chi2_above(chi2, freedom)), 1.0),
        float(np.sqrt(real * power / max(square, 1e-300))),
        1e3 * float(np.sqrt(real * power / max(samples, 1.0))),
    )


def _parts_of(group: Group, model: Model, parts: int) -> FloatArray:
    """The displacement (k, n) part by part, whole cycles each, less its mean and 0 elsewhere."""
    moved = group.predicted(model)
    begin, end = group.blocks[0][0], group.blocks[-1][1]
    turns = [int(k) for k in group.loops.start[2::2] if begin < k < end]
    count = min(parts, len(turns) + 1)
    edges = [begin, *(turns[k * len(turns) // count] for k in range(1, count)), end]
    out = np.zeros((count, moved.size))
    for row, (a, b) in zip(out, pairwise(edges), strict=True):
        row[a:b] = moved[a:b] - moved[a:b].mean()
    return out
