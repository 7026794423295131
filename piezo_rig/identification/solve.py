"""Small linear problems: bounded least squares on Gram matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
FLOOR = 1e-3  # a compliance stays above this share of the mean one
UNSEEN = 1e-10  # of the largest: a column with less variance was never visited
RANK = 1e-11  # of the largest eigenvalue: what lies below was never told apart
Runs = tuple[tuple[int, int], ...]


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


def untold(gram: FloatArray) -> FloatArray:
    """Basis of the changes of visited unknowns that the data do not see, shape (p, k)."""
    scale, seen = _scale(gram)
    values, vectors = np.linalg.eigh(gram[np.ix_(seen, seen)] * np.outer(scale[seen], scale[seen]))
    null = vectors[:, values < RANK * values[-1]]
    out = np.zeros((gram.shape[0], null.shape[1]))
    out[seen] = scale[seen, None] * null
    return out


def solve_smooth(
    gram: FloatArray,
    right: FloatArray,
    bounded: NDArray[np.bool_],
    floor: float,
    runs: Runs,
) -> FloatArray:
    """Like `solve_bounded`; what the data do not tell apart differs as little as it can.

    ``runs``: (first, one past last) index of neighbouring compliances.
    """
    null = untold(gram)
    if null.shape[1] == 0:
        return solve_bounded(gram, right, bounded, floor)
    scale, seen = _scale(gram)
    g = gram * np.outer(scale, scale)
    values, vectors = np.linalg.eigh(g)
    good = values > RANK * values[-1]
    x = scale * (vectors[:, good] @ ((right * scale) @ vectors[:, good] / values[good]))
    between = steps_between(seen, runs)
    shift, *_ = np.linalg.lstsq(between @ null, -(between @ x), rcond=None)
    x = x + null @ shift
    if np.all(x[bounded & seen] >= floor):
        return np.where(seen, x, np.nan)
    back = null / np.where(seen, scale, 1.0)[:, None] ** 2
    full = gram + back @ back.T
    return solve_bounded(full, full @ x, bounded, floor)


def steps_between(seen: NDArray[np.bool_], runs: Runs) -> FloatArray:
    """Matrix of the steps from every visited compliance of a run to the next, shape (m, p)."""
    rows = []
    for a, b in runs:
        index = a + np.flatnonzero(seen[a:b])
        row = np.zeros((max(index.size - 1, 0), seen.size))
        row[np.arange(index.size - 1), index[1:]] = 1.0
        row[np.arange(index.size - 1), index[:-1]] = -1.0
        rows.append(row)
    return np.concatenate(rows)


def _scale(gram: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    diagonal = np.diag(gram)
    seen = diagonal > UNSEEN * diagonal.max()
    scale = np.zeros(diagonal.size)
    scale[seen] = 1.0 / np.sqrt(diagonal[seen])
    return scale, seen


def continuity(
    x: FloatArray, runs: Runs, gram: FloatArray, noise: float
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
    """Of a Gram matrix with unit diagonal, over the unknowns that were visited.

    No larger than rounding lets it be told (about 1e14): more means that the rank is short.
    """
    diagonal = np.diag(gram)
    seen = diagonal > UNSEEN * diagonal.max()
    scale = 1.0 / np.sqrt(diagonal[seen])
    eigen = np.linalg.eigvalsh(gram[np.ix_(seen, seen)] * np.outer(scale, scale))
    least = np.finfo(float).eps * eigen.size * eigen[-1]
    return float(eigen[-1] / max(eigen[0], least))
