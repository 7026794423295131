"""Gauss-Newton on all unknowns of a fit: laws, first break, and break points where asked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezo_rig.errors import InputError
from piezo_rig.identification.curves import Curves
from piezo_rig.identification.data import Data
from piezo_rig.identification.normal import Piece, normal_equations, residuals, rms
from piezo_rig.identification.smooth import Prior

FloatArray = NDArray[np.float64]
STEPS = 40


def polish(
    data: Data,
    curves: Curves,
    pieces: tuple[Piece, ...],
    knots: bool,
    steps: int = STEPS,
    enough: float = 1e-5,
    prior: Prior | None = None,
) -> tuple[Curves, float]:
    """Damped Gauss-Newton from a start; returns the best fit and its rms in um.

    Stops when a step gains less than ``enough`` of the rms. With a prior (not with ``knots``)
    its penalty counts as a part of the residual sum of squares.
    """
    size = curves.pack(knots).size
    penalty = prior.penalty(size) if prior is not None else np.zeros((size, size))
    samples = sum(b - a for t in data.tracks for a, b in t.blocks)

    def error(left: list[FloatArray], x: FloatArray) -> float:
        return float(np.sqrt(rms(data, left) ** 2 + x @ penalty @ x / samples))

    left = residuals(data, curves)
    best = error(left, curves.pack(knots))
    damping = 1e-9
    for _ in range(steps):
        normal = normal_equations(data, curves, pieces, left, knots)
        x = curves.pack(knots)
        gram = normal.gram.sum(axis=0) + penalty
        right = normal.right.sum(axis=0) - penalty @ x
        bounded = curves.bounded(knots)
        gained = False
        for _ in range(8):
            step = _step(gram, right, damping)
            step *= _room(curves, x, step, bounded, knots)
            try:
                trial = curves.unpack(x + step, knots)
                trial_left = residuals(data, trial)
                value = error(trial_left, trial.pack(knots))
            except InputError:  # a law left its range: shorter step
                value = np.inf
            if value < best:
                gained = True
                break
            damping = max(damping * 30.0, 1e-9)
        if not gained:
            break
        gain = 1.0 - value / best
        curves, left, best = trial, trial_left, value
        damping = max(damping / 30.0, 1e-13)
        if gain < enough:
            break
    return curves, best


def _step(gram: FloatArray, right: FloatArray, damping: float) -> FloatArray:
    diagonal = np.diag(gram)
    seen = diagonal > 1e-14 * diagonal.max()
    scale = 1.0 / np.sqrt(diagonal[seen])
    g = gram[np.ix_(seen, seen)] * np.outer(scale, scale)
    g[np.diag_indices_from(g)] += damping
    step = np.zeros(right.size)
    try:  # as good as always; a rank that is short needs the slower way
        np.linalg.cholesky(g)
        solution = np.linalg.solve(g, right[seen] * scale)
    except np.linalg.LinAlgError:
        solution, *_ = np.linalg.lstsq(g, right[seen] * scale, rcond=1e-15)
    step[seen] = solution * scale
    return step


def _room(
    curves: Curves,
    x: FloatArray,
    step: FloatArray,
    bounded: NDArray[np.bool_],
    knots: bool,
) -> float:
    """Largest share of the step that keeps compliances positive and break points in order."""
    share = 1.0
    down = bounded & (step < 0)
    if np.any(down):
        share = min(share, float(np.min(-0.7 * x[down] / step[down])))
    if knots:
        for values, changes in zip(_knot_runs(curves, x), _knot_runs(curves, step), strict=True):
            gaps, moves = np.diff(values, prepend=0.0), np.diff(changes, prepend=0.0)
            closing = moves < 0
            if np.any(closing):
                share = min(share, float(np.min(-0.6 * gaps[closing] / moves[closing])))
    return max(share, 0.0)


def _knot_runs(curves: Curves, x: FloatArray) -> list[FloatArray]:
    n0 = curves.first_c.size - 1
    if curves.shared:
        return [x[-n0:]] if n0 else []
    moving = curves.later_c.size - (2 if curves.by_law else 1)
    first = x[x.size - n0 - moving : x.size - moving]
    return [run for run in (first, x[x.size - moving :] if moving else x[:0]) if run.size]
