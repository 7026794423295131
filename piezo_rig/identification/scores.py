"""How far predictions are from measurements."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Branches
from piezo_rig.errors import InputError
from piezo_rig.identification.curves import Curves
from piezo_rig.identification.data import Data
from piezo_rig.identification.folds import Folds
from piezo_rig.identification.normal import Normal
from piezo_rig.identification.smooth import Prior
from piezo_rig.identification.solve import continuity, solve_bounded

FloatArray = NDArray[np.float64]
FURTHER = 1.02  # swing of a drive, of that of all others: more is beyond them
FAR = 3.0  # times the full fit's error: a linearised refit that cannot be meant


@dataclass(frozen=True)
class Scores:
    """Errors over all samples with a known memory, the offset of every block taken out.

    Attributes
    ----------
    rms_nm, max_nm : nm
    max_percent : largest error in percent of its sweep's travel
    samples : how many were scored
    """

    rms_nm: float
    max_nm: float
    max_percent: float
    samples: int

    @classmethod
    def pooled(cls, parts: list[Scores]) -> Scores:
        n = sum(p.samples for p in parts)
        square = sum(p.rms_nm**2 * p.samples for p in parts)
        return cls(
            float(np.sqrt(square / n)),
            max(p.max_nm for p in parts),
            max(p.max_percent for p in parts),
            n,
        )


def _score(error: FloatArray, travel: float) -> Scores:
    largest = float(np.max(np.abs(error)))
    return Scores(
        1e3 * float(np.sqrt(error @ error / error.size)),
        1e3 * largest,
        100.0 * largest / travel if travel > 0 else 0.0,
        int(error.size),
    )


def scores(data: Data, branches: Branches) -> Scores:
    """Scores of a model's actuator on the data."""
    parts = []
    for track in data.tracks:
        walked = branches.walk(track.drive_v, track.loops)
        error = track.displacement_um - branches.displacement(track.drive_v, walked)
        for k, (a, b) in enumerate(track.blocks):
            parts.append(_score(error[a:b] - error[a:b].mean(), track.travel_um(k)))
    return Scores.pooled(parts)


@dataclass(frozen=True)
class HeldOut:
    """Scores on what a refit never saw.

    Attributes
    ----------
    whole : of everything
    within : without the folds whose drive swings further than all the rest, where a refit has to
        go beyond what it knows; None where nothing is left
    """

    whole: Scores
    within: Scores | None


def held_out_scores(
    data: Data,
    curves: Curves,
    normal: Normal,
    folds: Folds,
    floor: float,
    prior: Prior | None = None,
) -> HeldOut | None:
    """Scores on what a refit never saw; None where nothing can be held out.

    Every fold is refitted from the Gram matrices about the full fit; break points stay.
    """
    if folds.kind == "none":
        return None
    parts = _of_each_fold(data, curves, normal, folds, floor, prior)
    every = set(range(len(normal.pieces)))
    within = [
        p for own, group in zip(parts, folds.groups, strict=True) for p in own
        if _swing_v(data, normal, group) <= FURTHER * _swing_v(data, normal, every - set(group))
    ]  # fmt: skip
    return HeldOut(
        Scores.pooled([p for own in parts for p in own]), Scores.pooled(within) if within else None
    )


def _swing_v(data: Data, normal: Normal, group: Collection[int]) -> float:
    """How far the drive goes in some pieces, from the lowest to the highest, V."""
    own = [normal.pieces[i] for i in group]
    drives = [data.tracks[p.track].drive_v[p.begin : p.end] for p in own]
    high = max((float(d.max()) for d in drives), default=0.0)
    return high - min((float(d.min()) for d in drives), default=0.0)


def _of_each_fold(
    data: Data, curves: Curves, normal: Normal, folds: Folds, floor: float, prior: Prior | None
) -> list[list[Scores]]:
    all_gram, all_right = normal.gram.sum(axis=0), normal.right.sum(axis=0)
    if prior is not None:
        all_gram += prior.penalty(all_right.size)
    else:
        noise = float(normal.power.sum() / normal.count.sum())
        all_gram += continuity(curves.pack(False), curves.runs(), all_gram, noise)
    bounded, centre = curves.bounded(False), curves.pack(False)
    parts: list[list[Scores]] = []
    for group in folds.groups:
        held = list(group)
        gram = all_gram - normal.gram[held].sum(axis=0)
        right = all_right - normal.right[held].sum(axis=0)
        x = solve_bounded(gram, right, bounded, floor)
        full = _errors(data, normal, held, curves.branches())
        try:
            again = curves.unpack(_continued(x, curves, centre), False).branches()
            found = _errors(data, normal, held, again)
        except InputError:
            found = []
        if not found or Scores.pooled(found).rms_nm > FAR * Scores.pooled(full).rms_nm:
            # too far for a linearised law: it stays, and the curves are refitted around it
            x = _around_law(curves, gram, right, bounded, floor, centre)
            again = curves.unpack(_continued(x, curves, centre), False).branches()
            found = _errors(data, normal, held, again)
        parts.append(found)
    return parts


def _errors(data: Data, normal: Normal, held: list[int], branches: Branches) -> list[Scores]:
    out = []
    for t in sorted({normal.pieces[i].track for i in held}):
        track = data.tracks[t]
        walked = branches.walk(track.drive_v, track.loops)
        error = track.displacement_um - branches.displacement(track.drive_v, walked)
        for i in held:
            piece = normal.pieces[i]
            if piece.track == t:
                a, b = track.blocks[piece.block]
                e = error[piece.begin : piece.end] - error[a:b].mean()
                out.append(_score(e, track.travel_um(piece.block)))
    return out


def _around_law(
    curves: Curves,
    gram: FloatArray,
    right: FloatArray,
    bounded: NDArray[np.bool_],
    floor: float,
    centre: FloatArray,
) -> FloatArray:
    n0 = curves.first_c.size
    fixed = np.zeros(centre.size, bool)
    fixed[n0 : n0 + curves.q + (0 if curves.dx_um else 1)] = curves.by_law
    x = centre.copy()
    free = ~fixed
    reduced = right[free] - gram[np.ix_(free, fixed)] @ centre[fixed]
    x[free] = solve_bounded(gram[np.ix_(free, free)], reduced, bounded[free], floor)
    return x


def _continued(x: FloatArray, curves: Curves, centre: FloatArray) -> FloatArray:
    """Bands that only the held-out data visit go on with the slope before them."""
    x = x.copy()
    starts = {0, curves.first_c.size}
    for i in np.flatnonzero(np.isnan(x)):
        x[i] = centre[i] if i in starts or np.isnan(x[i - 1]) else x[i - 1]
    return x
