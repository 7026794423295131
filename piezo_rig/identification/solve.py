"""Small linear problems: bounded least squares on Gram matrices, and many of them at once."""

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


def solve_many(
    gram: FloatArray,
    right: FloatArray,
    weights: FloatArray,
    bounded: NDArray[np.bool_],
    floor: float,
) -> FloatArray:
    """Refits on weighted sums of pieces.

    Parameters
    ----------
    gram, right : shapes (m, p, p) and (m, p)
    weights : shape (k, m), how often each piece was drawn

    Returns
    -------
    shape (k, p); where the free solution breaks a bound, the bounded one
    """
    m, p, _ = gram.shape
    diagonal = np.diag(gram.sum(axis=0))
    seen = diagonal > UNSEEN * diagonal.max()
    scale = 1.0 / np.sqrt(diagonal[seen])
    x = np.full((weights.shape[0], p), np.nan)
    g = gram[:, seen][:, :, seen] * np.outer(scale, scale)
    r = right[:, seen] * scale
    size = int(seen.sum())
    small = 1e-12 * np.eye(size) * weights.sum(axis=1).mean() / m
    for first in range(0, weights.shape[0], 250):
        w = weights[first : first + 250]
        grams = (w @ g.reshape(m, -1)).reshape(-1, size, size) + small
        rights = w @ r
        free = np.linalg.solve(grams, rights[:, :, None])[:, :, 0] * scale
        broken = np.any(free[:, bounded[seen]] < floor, axis=1)
        for i in np.flatnonzero(broken):
            full_gram, full_right = np.zeros((p, p)), np.zeros(p)
            full_gram[np.ix_(seen, seen)] = grams[i] / np.outer(scale, scale)
            full_right[seen] = rights[i] / scale
            free[i] = solve_bounded(full_gram, full_right, bounded, floor)[seen]
        x[first : first + 250, seen] = free
    return x
