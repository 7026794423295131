"""Whether recordings of one drive differ by a share of the displacement: a gain that is not steady.

What repeats disagree by is taken for noise. Noise knows nothing of where the actuator stands; what
follows the displacement, more in one recording or one cycle than in another, is no noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from piezo_rig.chain import Model
from piezo_rig.diagnosis.cells import Cells
from piezo_rig.diagnosis.chances import fisher_above
from piezo_rig.diagnosis.groups import Group, Groups
from piezo_rig.diagnosis.whitening import CellWhitener

FloatArray = NDArray[np.float64]
PARTS = 12  # of a recording, at most, each with a gain of its own
SPEEDS = (0.763, 1.31)  # at which noise is asked, beside the displacement's own
LITTLE = 1e-3  # of the largest singular value: columns of parts that hardly move, or repeat others


@dataclass(frozen=True)
class Unsteady:
    """``share`` of the displacement (rms), and its ``rms_nm``, by which recordings differ."""

    p_value: float
    share: float
    rms_nm: float


def unsteady(groups: Groups, whitener: CellWhitener, model: Model) -> Unsteady | None:
    """How far a gain changes between repeats and along them; None without repeats.

    Deviations from the mean of a drive's recordings are fitted by the displacement, recording by
    recording, and part by part of each; of the two the likelier counts, twice. Noise is no more of
    the displacement than of the same played somewhat faster or slower, which is fitted as well:
    the ratio (Fisher's law) does not hang on how well the spectrum is known.
    """
    if not any(g.repeats > 1 for g in groups.groups):
        return None
    found = [_by_parts(groups, whitener, model, parts) for parts in (1, PARTS)]
    return min(found, key=lambda u: u.p_value)


def _by_parts(groups: Groups, whitener: CellWhitener, model: Model, parts: int) -> Unsteady:
    chi2, beside = np.zeros(2), np.zeros(2)  # sum of squares, and of how many
    power = square = samples = 0.0
    for group in groups.groups:
        if group.repeats < 2:
            continue
        left = group.at_one_time(model).measured_um
        left = groups.thinned(group, left - left.mean(axis=0))
        moved, other = (groups.thinned(group, x) for x in _parts_of(group, model, parts))
        for (a, b), cells in zip(groups.edges(group), groups.cells(group), strict=True):
            rows = _white(whitener, left[:, a:b], cells)
            gains, rank, found = _fitted(_white(whitener, moved[:, a:b], cells), rows)
            chi2 += found, rank * (group.repeats - 1)
            _, rank, found = _fitted(_white(whitener, other[:, a:b], cells), rows)
            beside += found, rank * (group.repeats - 1)
            lengths = np.sum(cells.centred(moved[:, a:b]) ** 2, axis=1)
            power += float(lengths @ np.sum(gains**2, axis=1))
            square += group.repeats * float(lengths.sum())
            samples += group.repeats * float(cells.share.sum())
    if not (chi2[1] and beside[1]):  # nothing moves
        return Unsteady(1.0, 0.0, 0.0)
    noise = max(beside[0] / beside[1], 1.0)
    ratio = chi2[0] / chi2[1] / noise
    real = max(1.0 - 1.0 / max(ratio, 1e-300), 0.0)  # not what noise alone would make
    return Unsteady(
        min(2.0 * fisher_above(ratio, chi2[1], beside[1]), 1.0),
        float(np.sqrt(real * power / max(square, 1e-300))),
        1e3 * float(np.sqrt(real * power / max(samples, 1.0))),
    )


def _white(whitener: CellWhitener, rows: FloatArray, cells: Cells) -> FloatArray:
    """Rows whitened, their offsets projected out."""
    white, one = whitener(rows, cells), whitener.ones(cells)
    return np.asarray(white - np.outer(white @ one / float(one @ one), one))


def _fitted(columns: FloatArray, rows: FloatArray) -> tuple[FloatArray, int, float]:
    """Shares (k, R) of columns in rows, how many directions they have, and the squares explained.
    """
    gains, _, rank, _ = np.linalg.lstsq(columns.T, rows.T, rcond=LITTLE)
    return np.asarray(gains), int(rank), float(np.sum((columns.T @ gains) ** 2))


def _parts_of(group: Group, model: Model, parts: int) -> tuple[FloatArray, FloatArray]:
    """The displacement (k, n) part by part, whole cycles each, less its mean and 0 elsewhere; and
    the same at other speeds, each also with every frequency a quarter of its period later.
    """
    moved = group.predicted(model)
    begin, end = group.blocks[0][0], group.blocks[-1][1]
    turns = [int(k) for k in group.loops.start[2::2] if begin < k < end]
    count = min(parts, len(turns) + 1)
    edges = [begin, *(turns[k * len(turns) // count] for k in range(1, count)), end]
    out, other = np.zeros((count, moved.size)), np.zeros((2 * len(SPEEDS), count, moved.size))
    for k, (a, b) in enumerate(pairwise(edges)):
        part = moved[a:b] - moved[a:b].mean()
        out[k, a:b] = part
        for j, speed in enumerate(SPEEDS):
            warped = np.interp(speed * np.arange(b - a), np.arange(b - a), part, period=b - a)
            warped -= warped.mean()
            other[2 * j, k, a:b] = warped
            other[2 * j + 1, k, a:b] = fft.irfft(-1j * fft.rfft(warped), b - a)
    return out, other.reshape(-1, moved.size)
