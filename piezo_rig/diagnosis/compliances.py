"""Compliances by least squares: none of them negative, smooth where data do not say."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from piezo_rig.diagnosis.fit import FLOOR, SECOND, Point, smoothness
from piezo_rig.diagnosis.linear import Linear
from piezo_rig.identification.solve import solve_bounded

FloatArray = NDArray[np.float64]
TOGETHER = 3.0  # samples that count as one, for the weight of what holds them together


def element_step(
    point: Point, linear: Linear, pieces: Sequence[int] | None, moved: FloatArray
) -> FloatArray:
    """Change (p,) of the compliances once stage parameters have moved by ``moved`` (q,)."""
    raw = linear.raw(pieces)
    n = point.linear
    if n == 0:
        return np.zeros(0)
    values = point.values()
    right = raw[:n, -1] - raw[:n, n:-1] @ moved
    rows = smoothness(point)[:, :n]
    weight = smooth_weight(point, linear, pieces)
    gram = raw[:n, :n] + weight * rows.T @ rows
    gram += 1e-12 * np.diag(np.diag(gram)) + 1e-300 * np.eye(n)
    right = right - weight * rows.T @ (rows @ values[:n])
    compliances = values[: point.compliances]
    least = FLOOR * float(np.mean(np.abs(compliances))) if compliances.size else 0.0
    return solved(gram, right, least - compliances)


def solved(gram: FloatArray, right: FloatArray, least: FloatArray) -> FloatArray:
    """Solution (n,) of a positive definite system, the first k numbers of which are no less than
    ``least`` (k,): of all such the one that leaves least, which is not the free one cut off there.
    """
    k = least.size
    free = np.asarray(np.linalg.solve(gram, right))
    if np.all(free[:k] >= least):
        return free
    begin = np.concatenate([least, np.zeros(right.size - k)])
    above = solve_bounded(gram, right - gram @ begin, np.arange(right.size) < k, 0.0)
    unseen = np.isnan(above)
    above[unseen] = np.maximum(free - begin, 0.0)[unseen]
    return begin + above


def smooth_weight(point: Point, linear: Linear, pieces: Sequence[int] | None = None) -> float:
    """How strongly compliances that the data do not know follow their neighbours.

    The noise that is left sets how softly.
    """
    if not point.compliances:
        return 0.0
    raw = linear.raw(pieces)
    values, n = point.values(), point.linear
    count = linear.count.sum() if pieces is None else linear.count[list(pieces)].sum()
    left = raw[-1, -1] / max(count, 1.0)
    mean = float(np.mean(np.abs(values[: point.compliances])))
    weight = max(left, 1e-12 * values[:n] @ values[:n]) * TOGETHER / (SECOND * mean) ** 2
    return float(min(weight, 1e3 * float(np.mean(np.diag(raw)[:n]))))
