"""How sure a fit is: pieces drawn again, and refits from their Gram matrices.

Neighbouring elements are nearly interchangeable (the Gram matrix of 40 play
operators has a condition number of 1e7), so what is reported is the band of
the distribution and of the response, never one weight by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.identification.curves import Curves
from piezo_rig.identification.data import Data
from piezo_rig.identification.normal import Normal, Piece, normal_equations, residuals
from piezo_rig.identification.solve import condition_number, solve_many

FloatArray = NDArray[np.float64]
DRAWS = 1000


@dataclass(frozen=True, eq=False)
class Bands:
    """95 % bands of a fit.

    Attributes
    ----------
    drive_v : shape (m,), drive of a first rise, or half the drive change of a later branch
    first_um, later_um : shape (m, 2), band of the first rise, and of the later branch over
        2 x drive_v
    first_compliance, later_compliance : shape (n, 2), band of every compliance, um/V
    laws : parameter -> interval
    condition_number : of the Gram matrix with unit diagonal
    drawn : what was drawn again, and how often
    """

    drive_v: FloatArray
    first_um: FloatArray
    later_um: FloatArray
    first_compliance: FloatArray
    later_compliance: FloatArray
    laws: dict[tuple[str, str], tuple[float, float]]
    condition_number: float
    drawn: str


def linearised(data: Data, curves: Curves, pieces: tuple[Piece, ...]) -> Normal:
    """Normal equations for all unknowns (break points held) about a fit."""
    normal = normal_equations(data, curves, pieces, residuals(data, curves))
    x = curves.pack(False)
    right = normal.right + normal.gram @ x
    return Normal(normal.gram, right, normal.power, normal.count, normal.pieces)


def bands(
    data: Data, curves: Curves, normal: Normal, floor: float, seed: int, draws: int = DRAWS
) -> Bands:
    """Bootstrap over sweeps (over cycles, with one sweep)."""
    units = sorted({p.sweep for p in normal.pieces})
    per_sweep = len(units) > 1
    owner = np.arange(len(normal.pieces))
    if per_sweep:
        owner = np.array([units.index(p.sweep) for p in normal.pieces])
    count = int(owner.max()) + 1
    gram = np.zeros((count, *normal.gram.shape[1:]))
    right = np.zeros((count, normal.right.shape[1]))
    np.add.at(gram, owner, normal.gram)
    np.add.at(right, owner, normal.right)
    rng = np.random.default_rng(seed)
    weights = rng.multinomial(count, np.full(count, 1.0 / count), size=draws).astype(float)
    bounded = curves.bounded(False)
    x = solve_many(gram, right, weights, bounded, floor)
    # few units vary too little when drawn with replacement
    centre = curves.pack(False)
    spread = np.sqrt(count / max(count - 1.0, 1.0))
    unseen = np.isnan(x)
    x = np.where(unseen, 0.0, x)
    x = np.where(unseen, centre, centre + spread * (x - x.mean(axis=0)))
    x[:, bounded] = np.maximum(x[:, bounded], floor)
    reach = max(data.first_reach_v, data.later_reach_v / 2.0)
    drive = np.linspace(0.0, reach, 76)
    drawn = [curves.unpack(row, False) for row in x]
    first_c = np.array([c.first_c for c in drawn])
    later_c = np.array([c.later_c for c in drawn])
    n0, q = curves.first_c.size, curves.q
    laws = {}
    if curves.by_law:
        values = x[:, n0 : n0 + q]
        for k, (i, name) in enumerate(curves.law_names):
            laws[(curves.laws[i].id, name)] = _interval(values[:, 1 + k])
        offsets = [s for s in curves.laws if "offset" in s.units]
        if offsets:
            laws[(offsets[0].id, "offset")] = _interval(1.0 / values[:, 0] - 1.0 / later_c[:, 1])
    return Bands(
        drive,
        _band(np.array([_rise(c.first_knots, c.first_c, drive) for c in drawn])),
        _band(np.array([_rise(c.later_knots, c.later_c, 2.0 * drive) for c in drawn])),
        _band(first_c),
        _band(later_c),
        laws,
        condition_number(normal.gram.sum(axis=0)),
        f"{count} {'sweeps' if per_sweep else 'cycles'} drawn {draws} times",
    )


def _rise(knots: FloatArray, compliance: FloatArray, drive: FloatArray) -> FloatArray:
    """A piecewise linear curve at the drives (m,)."""
    end = max(float(drive[-1]), float(knots[-1]) if knots.size else 0.0) + 1.0
    edges = np.concatenate([[0.0], knots, [end]])
    heights = np.concatenate([[0.0], np.cumsum(compliance * np.diff(edges))])
    return np.interp(drive, edges, heights)


def _band(values: FloatArray) -> FloatArray:
    return np.percentile(values, [2.5, 97.5], axis=0).T


def _interval(values: FloatArray) -> tuple[float, float]:
    low, high = np.percentile(values, [2.5, 97.5])
    return float(low), float(high)
