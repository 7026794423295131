"""The bend that a fit could not follow: told in the model file, not put into the model.

A named model is what the thesis says, springs and sliders. Where the actuator's reversible strain
is not linear in the drive, they follow that as well as they can, and the rest is the same in every
later recording. Whoever holds the model against those needs to know it, or will take it for news.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Stage
from piezo_rig.chain.bend import POWERS, Bend
from piezo_rig.identification.curves import Curves
from piezo_rig.identification.data import Data
from piezo_rig.identification.folds import Folds
from piezo_rig.identification.least_squares import LeastSquares, floor_of
from piezo_rig.identification.least_squares import fit as least_squares_fit
from piezo_rig.identification.normal import (
    centred,
    finer,
    normal_equations,
    pieces_of,
    residuals,
    rms,
)
from piezo_rig.identification.polish import polish
from piezo_rig.identification.scores import held_out_scores, scores
from piezo_rig.identification.solve import solve_bounded
from piezo_rig.identification.tied import FINE_PIECES, beginnings, prior_of
from piezo_rig.identification.uncertainty import linearised

FloatArray = NDArray[np.float64]
HELPS = 0.9  # rms with a bend, of that without, above which nothing is told
ROUNDS = 2
TOO_SMALL = 1e-5  # of the travel: what no bend is looked for in
RIDGE = 1e-10  # of the scaled Gram matrix


@dataclass(frozen=True, eq=False)
class Bent:
    """A fit with a bend beside it.

    Attributes
    ----------
    curves, bend : the two together
    rms_nm : held-out error
    within_nm : the same of what swings no further than the rest
    """

    curves: Curves
    bend: Stage
    rms_nm: float
    within_nm: float


def bent(
    data: Data, fit: LeastSquares, one_curve: bool, laws: tuple[type[Stage], ...],
    elements: int | None,
) -> Bent | None:
    """The same fit beside a bend; None where a bend hardly helps.

    Parameters
    ----------
    data : all of it; one repeat, and the beginnings of long tracks, are looked at
    fit : of all of it
    one_curve, laws, elements : as it was fitted
    """
    few = beginnings(data.one_repeat())
    if rms(few, residuals(few, fit.curves)) < TOO_SMALL * data.travel_um:
        return None
    low = min(float(t.drive_v.min()) for t in few.tracks)
    span = max(float(t.drive_v.max()) for t in few.tracks) - low
    powers = [[((t.drive_v - low) / span) ** p for t in few.tracks] for p in POWERS.values()]
    share, total = _bend_of(few, fit, powers, few.samples / data.samples)
    if share > HELPS:
        return None
    left, found = few, fit
    for more in range(ROUNDS):  # with the bend gone the fit knows less noise, and follows more
        total += _bend_of(left, found, powers, 1.0)[1] if more else 0.0
        bends = [sum(b * p[k] for b, p in zip(total, powers, strict=True))
                 for k in range(len(few.tracks))]  # fmt: skip
        left = replace(few, tracks=tuple(
            replace(t, displacement_um=t.displacement_um - b)
            for t, b in zip(few.tracks, bends, strict=True)
        ))  # fmt: skip
        found = _again(left, found, one_curve, laws, elements)
    normal = linearised(left, found.curves, found.pieces)
    held = held_out_scores(left, found.curves, normal, found.folds, floor_of(left), found.prior)
    fitted = scores(left, found.curves.branches())
    whole, within = (held.whole, held.within or fitted) if held else (fitted, fitted)
    values = dict(zip(POWERS, map(float, total), strict=True))
    bend = Bend.of(None, from_v=low, over_v=span, **values)
    return Bent(found.curves, bend, whole.rms_nm, within.rms_nm)


def _again(
    left: Data, fit: LeastSquares, one_curve: bool, laws: tuple[type[Stage], ...],
    elements: int | None,
) -> LeastSquares:
    """The fit of what is left without the bend; laws go on from where they are."""
    if not laws:
        return least_squares_fit(left, one_curve, laws, elements, lambda what, share: None)
    pieces = pieces_of(left, cycles=fit.folds.kind == "cycles")
    prior = fit.prior
    if prior is not None:
        about = linearised(left, fit.curves, finer(left, pieces, FINE_PIECES)[0])
        prior = prior_of(left, fit.curves, about, fit.curves.pack(False))
    curves, _ = polish(left, fit.curves, pieces, False, steps=8, enough=1e-3, prior=prior)
    return replace(fit, curves=curves, pieces=pieces, prior=prior, folds=Folds.of(left))


def _bend_of(
    few: Data, fit: LeastSquares, powers: list[list[FloatArray]], part: float
) -> tuple[float, FloatArray]:
    """Coefficients of the powers, the curves free, linearised about a fit.

    Parameters
    ----------
    powers : of the drive, of every track
    part : share of the data that the fit was made of

    Returns
    -------
    share : rms error with them, of that without
    values : shape (powers,), um
    """
    pieces, curves = pieces_of(few), fit.curves
    left = residuals(few, curves)
    about = normal_equations(few, curves, pieces, left)
    gram, right = about.gram.sum(axis=0), about.right.sum(axis=0)
    cross = np.stack([
        normal_equations(few, curves, pieces, p).right.sum(axis=0) for p in powers
    ], axis=1)  # fmt: skip
    of_powers = np.array([_flat(few, p) for p in powers])
    x = curves.pack(False)
    target = gram @ x + right
    if fit.prior is not None:
        gram += fit.prior.penalty(x.size) * part
    # what the curves cannot do of the powers, and what of the data is like that
    solved = _solved(gram, np.column_stack([cross, target]))
    whole = of_powers @ of_powers.T
    rest = whole - cross.T @ solved[:, :-1]
    rest[np.diag(rest) <= RIDGE * np.diag(whole)] = 0.0  # what the curves can do altogether
    z = of_powers @ _flat(few, left) + cross.T @ (x - solved[:, -1])
    values = _solved(rest, z[:, None])[:, 0]
    moved = solve_bounded(gram, target - cross @ values, curves.bounded(False), floor_of(few))
    moved = np.where(np.isnan(moved), x, moved)
    changed = curves.unpack(moved, False)
    less = [
        r - sum(b * p[t] for b, p in zip(values, powers, strict=True))
        for t, r in enumerate(residuals(few, changed))
    ]
    return rms(few, less) / max(rms(few, left), 1e-300), values


def _solved(gram: FloatArray, right: FloatArray) -> FloatArray:
    """Columns (p, k) of unknowns; 0 where the data never were."""
    out, seen = np.zeros(right.shape), np.diag(gram) > 0.0
    size = 1.0 / np.sqrt(np.diag(gram)[seen])
    scaled = gram[np.ix_(seen, seen)] * np.outer(size, size) + RIDGE * np.eye(size.size)
    out[seen] = size[:, None] * np.linalg.solve(scaled, size[:, None] * right[seen])
    return out


def _flat(data: Data, values: list[FloatArray]) -> FloatArray:
    """All blocks, their means taken out, one after the other."""
    return np.concatenate([
        b for t, v in zip(data.tracks, values, strict=True) for b in centred(t, v)
    ])
