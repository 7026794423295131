"""Whether recordings of one drive differ by a share of the displacement: a gain that is not steady.

What repeats disagree by is taken for noise. Noise knows nothing of where the actuator stands; what
follows the displacement, more in one recording or one cycle than in another, is no noise. Where a
drive was recorded once and comes back, its cycles are compared.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from piezo_rig.chain import Model
from piezo_rig.diagnosis.chances import fisher_above
from piezo_rig.diagnosis.dictionary import hats_of
from piezo_rig.diagnosis.groups import Group, Groups
from piezo_rig.diagnosis.periods import period_s
from piezo_rig.diagnosis.whitening import CellWhitener

FloatArray = NDArray[np.float64]
CYCLES = 6  # of a drive that was recorded once
PLACES = (1, 4, 12)  # along a recording, between which a gain of its own goes in straight lines
SPEEDS = (0.763, 1.31)  # at which noise is asked, beside the displacement's own
HALFWAY = (0.5, 1.5)  # the same of cycles: as far from their lines as can be
LITTLE = 1e-3  # of the largest singular value: columns of parts that hardly move, or repeat others


@dataclass(frozen=True)
class Unsteady:
    """``share`` of the displacement (rms), and its ``rms_nm``, by which recordings differ."""

    p_value: float
    share: float
    rms_nm: float


def unsteady(groups: Groups, whitener: CellWhitener, model: Model) -> Unsteady | None:
    """How far a gain changes between repeats and along them; None without repeats.

    Deviations from the mean of a drive's recordings are fitted by the displacement times a gain
    that is the same all along each of them, or goes in straight lines between a few places or
    many; the likeliest counts, as often as was tried. Noise is no more of the displacement than of
    the same played somewhat faster or slower, which is fitted as well: the ratio (Fisher's law)
    does not hang on how well the spectrum is known.
    """
    own = [_repeats(g, model) for g in groups.groups]
    return _likeliest(groups, own, whitener, model, PLACES)


def unsteady_cycles(groups: Groups, whitener: CellWhitener, model: Model) -> Unsteady | None:
    """The same of the cycles of drives that were recorded once and come back; None without any.

    What the model gets wrong in every cycle is taken off with their mean.
    """
    own = [_cycles(g, model) for g in groups.groups]
    return _likeliest(groups, own, whitener, model, PLACES[1:])  # the model has a gain


class _Own(NamedTuple):
    """What is a group's own beside the mean of what should be alike.

    ``left`` (k, n) in displacement, with so many degrees of ``freedom`` a column; ``beside`` takes
    that mean off other rows; ``steady`` : whether a steady gain goes with it; ``speeds`` at which
    noise is asked
    """

    left: FloatArray
    freedom: int
    beside: Callable[[FloatArray], FloatArray]
    steady: bool = False
    speeds: Sequence[float] = SPEEDS


def _repeats(group: Group, model: Model) -> _Own | None:
    if group.repeats < 2:
        return None
    rows = group.at_one_time(model).measured_um
    return _Own(rows - rows.mean(axis=0), group.repeats - 1, lambda rows: rows)


def _cycles(group: Group, model: Model) -> _Own | None:
    """None where the drive was recorded more than once, or does not come back often enough.

    The first cycle may rise from rest: it is not among them.
    """
    seconds = period_s(group) if group.repeats < 2 else None
    if seconds is None:
        return None
    period = seconds / float(group.time_s[1] - group.time_s[0])
    begin, end = group.blocks[-1]
    begin += round(period)
    end = begin + int((end - begin) / period) * round(period)
    if end - begin < CYCLES * period:
        return None
    phase = np.rint(np.arange(end - begin) % period).astype(int)
    count = np.maximum(np.bincount(phase), 1)

    def beside(rows: FloatArray) -> FloatArray:
        out = np.zeros_like(rows)
        for row, made in zip(rows, out, strict=True):
            cut = row[begin:end]
            made[begin:end] = cut - (np.bincount(phase, cut) / count)[phase]
        return out

    return _Own(beside(group.measured_um - group.predicted(model)), 1, beside, True, HALFWAY)


def _likeliest(
    groups: Groups, own: Sequence[_Own | None], whitener: CellWhitener, model: Model,
    tried: Sequence[int],
) -> Unsteady | None:  # fmt: skip
    if not any(own):
        return None
    found = [_between(groups, own, whitener, model, places) for places in tried]
    return min(found, key=lambda u: u.p_value)


def _between(
    groups: Groups, every: Sequence[_Own | None], whitener: CellWhitener, model: Model, places: int
) -> Unsteady:
    chi2, beside = np.zeros(2), np.zeros(2)  # sum of squares, and of how many
    power = shares = samples = 0.0
    for group, own in zip(groups.groups, every, strict=True):
        if own is None:
            continue
        hats, moved, others = _columns(group, model, places, own.steady, own.speeds)
        left, hats, moved, others = (
            groups.thinned(group, x)
            for x in (own.left, hats, own.beside(moved), own.beside(others))
        )
        for (a, b), cells in zip(groups.edges(group), groups.cells(group), strict=True):
            rows = whitener.beside_offset(left[:, a:b], cells)
            gains, rank, found = _fitted(whitener.beside_offset(moved[:, a:b], cells), rows)
            chi2 += found, rank * own.freedom
            _, rank, found = _fitted(whitener.beside_offset(others[:, a:b], cells), rows)
            beside += found, rank * own.freedom
            power += float(np.sum(cells.centred(gains.T @ moved[:, a:b]) ** 2))
            shares += float(cells.share @ np.sum((gains.T @ hats[:, a:b]) ** 2, axis=0))
            samples += group.repeats * float(cells.share.sum())
    if not (chi2[1] and beside[1]):  # nothing moves
        return Unsteady(1.0, 0.0, 0.0)
    noise = max(beside[0] / beside[1], 1.0)
    ratio = chi2[0] / chi2[1] / noise
    real = max(1.0 - 1.0 / max(ratio, 1e-300), 0.0)  # not what noise alone would make
    chance = len(PLACES) * fisher_above(ratio, chi2[1], beside[1])
    share, size = (float(np.sqrt(real * x / max(samples, 1.0))) for x in (shares, power))
    return Unsteady(min(chance, 1.0), share, 1e3 * size)


def _fitted(columns: FloatArray, rows: FloatArray) -> tuple[FloatArray, int, float]:
    """Shares (k, R) of columns in rows, how many directions they have, and the squares explained.
    """
    gains, _, rank, _ = np.linalg.lstsq(columns.T, rows.T, rcond=LITTLE)
    return np.asarray(gains), int(rank), float(np.sum((columns.T @ gains) ** 2))


def _columns(
    group: Group, model: Model, places: int, steady: bool, speeds: Sequence[float]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Straight lines (k, n) from one at a place to none at its neighbours, times the displacement,
    and times the same at other speeds, each also with every frequency a quarter of its period
    later. ``steady`` : without what is the same all along
    """
    begin, end = group.blocks[0][0], group.blocks[-1][1]
    at = np.arange(float(group.drive_v.size))
    moved = group.predicted(model)
    within = moved[begin:end]
    hats = hats_of(at, np.linspace(begin, end - 1, places))
    hats = np.diff(hats, axis=0) if steady else hats
    hats[:, (at < begin) | (at >= end)] = 0.0
    others = []
    for speed in speeds:
        warped = np.interp(
            speed * np.arange(within.size), np.arange(within.size), within, period=within.size
        )
        later = fft.irfft(-1j * fft.rfft(warped - warped.mean()), within.size)
        others += [np.pad(x, (begin, moved.size - end)) for x in (warped, warped.mean() + later)]
    return hats, hats * moved, np.concatenate([hats * x for x in others])
