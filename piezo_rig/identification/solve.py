"""Small linear problems: bounded least squares on Gram matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
FLOOR = 1e-3  # a compliance stays above this share of the mean one
UNSEEN = 1e-10  # of the largest: a column with less variance was never visited


def solve_bounded(
    gram: FloatArray, right: FloatArray, bounded: NDArray[np.bool_], floor: float
) -> FloatArray:
    """Minimise x'Gx - 2 x'r with the bounded unknowns at or above ``floor``; shape (p,).

    Non-negative least squares on the Cholesky factor of G (Lawson and Hanson 1974, ch. 23).
    Unknowns that the data never visit come back as NaN.
    """
    from scipy.optimize import nnls

    diagonal = np.diag(gram)
    seen = diagonal > UNSEEN * diagonal.max()
    x = np.full(right.size, np.nan)
    scale = 1.0 / np.sqrt(diagonal[seen])
    g = gram[np.ix_(seen, seen)] * np.outer(scale, scale)
    lower = np.where(bounded[seen], floor, 0.0) / scale
    r = right[seen] * scale - g @ lower
    factor = _factor(g)
    target = np.linalg.solve(factor, r)
    free = np.linalg.solve(factor.T, target)
    inside = bounded[seen]
    if np.all(free[inside] >= 0):
        z = free
    else:
        columns = [factor.T, -factor.T[:, ~inside]]
        doubled, _ = nnls(np.hstack(columns), target, maxiter=50 * right.size)
        z = doubled[: seen.sum()]
        z[~inside] -= doubled[seen.sum() :]
    x[seen] = (z + lower) * scale
    return x


def continuity(
    x: FloatArray, runs: tuple[tuple[int, int], ...], gram: FloatArray, noise: float
) -> FloatArray:
    """Ridge on steps between neighbouring compliances, shape (p, p).

    For refits on less than all data: a band that is then hardly visited goes on with its
    neighbour's compliance. The weight is one sample of noise against a step as large as the
    compliance itself, so that whatever the data do say counts for more.

    Parameters
    ----------
    x : a fit, for the size of compliances
    runs : (first, one past last) index of neighbouring compliances
    gram : runs that it never visits stay as they are
    noise : variance of a sample, um^2
    """
    out = np.zeros_like(gram)
    for a, b in runs:
        size = float(np.mean(np.abs(x[a:b]))) if b > a else 0.0
        if size == 0.0 or not np.any(np.diag(gram)[a:b] > 0):
            continue
        steps = np.diff(np.eye(b - a), axis=0)
        out[a:b, a:b] = noise / size**2 * (steps.T @ steps)
    return out


def _factor(g: FloatArray) -> FloatArray:
    """Cholesky factor of a unit-diagonal Gram matrix, with the least ridge that it needs."""
    ridge = 0.0
    for _ in range(12):
        try:
            return np.asarray(np.linalg.cholesky(g + ridge * np.eye(g.shape[0])), float)
        except np.linalg.LinAlgError:
            ridge = max(10.0 * ridge, 1e-14)
    return np.asarray(np.linalg.cholesky(g + 1e-2 * np.eye(g.shape[0])), float)


def fill_unseen(values: FloatArray) -> FloatArray:
    """Bands that were never visited take the compliance of the nearest one before (or after)."""
    known = np.flatnonzero(np.isfinite(values))
    if known.size == 0:
        raise ValueError("no band was visited")
    index = np.clip(np.searchsorted(known, np.arange(values.size), side="right") - 1, 0, None)
    return np.where(np.isfinite(values), values, values[known[index]])


def condition_number(gram: FloatArray) -> float:
    """Of the Gram matrix with unit diagonal, over the unknowns that were visited."""
    diagonal = np.diag(gram)
    seen = diagonal > UNSEEN * diagonal.max()
    scale = 1.0 / np.sqrt(diagonal[seen])
    eigen = np.linalg.eigvalsh(gram[np.ix_(seen, seen)] * np.outer(scale, scale))
    return float(eigen[-1] / max(eigen[0], 1e-300))
