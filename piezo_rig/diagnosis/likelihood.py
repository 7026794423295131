"""Marginal likelihoods on reduced columns: the score of every cause, and its calibration.

What the base model can follow is projected out. In what is left the residual is

    z = T_c b + F a + U g + e,    a ~ N(0, s1), g ~ N(0, s2), e ~ N(0, 1)

with T_c a cause's signatures, F the fine thresholds and U the generic dictionary (base mismatch,
and the rival "nobody has a name for it"). The scales s1, s2 are profiled anew under every
hypothesis (`scores` compares them).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from piezo_rig.diagnosis.reduction import Reduced

FloatArray = NDArray[np.float64]
GRID = np.concatenate([[0.0], 7.0 ** np.arange(-1.0, 6.0)])  # of variance, in units below
Cell = tuple[int, int]  # of the grid of both scales
STARTS = (0, 4)  # scales of the fine thresholds that a climb looks at first
NONE = np.zeros(0, np.int64)
SAME = 1e-4  # of the largest singular value: columns that only repeat others


class Seen(NamedTuple):
    """Data and trial columns at one pair of scales, whitened by them.

    ``plain`` (k,) log-likelihood without any trial; ``gram`` (t, t) of the trials; ``along``
    (t, k) their products with the data
    """

    plain: FloatArray
    gram: FloatArray
    along: FloatArray


class Likelihood:
    """The likelihood on a grid of scales, for one reduced problem.

    Where the residual alone is asked for, the grid is climbed; a score takes all of it.
    """

    def __init__(self, reduced: Reduced) -> None:
        self.reduced = reduced
        self._known: dict[int, list[Seen]] = {}

    def scales_at(self, cell: Cell) -> tuple[float, float]:
        units = self.reduced.unit_fine, self.reduced.unit_generic
        fine, generic = (
            float(min(GRID[k] * unit, most))
            for k, unit, most in zip(cell, units, self.reduced.most, strict=True)
        )
        return fine, generic

    def seen(
        self, i: int, y: FloatArray, columns: NDArray[np.int64] | None = None
    ) -> list[Seen]:
        """Data (m, k) and trials at a scale of the fine thresholds and each of the dictionary.

        Empty where rounding decides. ``columns`` : of the trials, those that are asked for
        """
        row = self.reduced.covariance.row(self.scales_at((i, 0))[0])
        if row is None:
            return []
        k, n = y.shape[1], len(row.lower)
        trials = self.reduced.trials
        if columns is not None:
            trials = trials[:, columns]
        both = np.empty((n, k + trials.shape[1]), order="F")
        both[:, :k], both[:, k:] = y[:n], trials[:n]
        white, _ = lapack.dtrtrs(row.lower, both, lower=1, overwrite_b=1)
        w, t = white[:, :k], white[:, k:]
        square, gram, along = np.einsum("ik,ik->k", w, w), t.T @ t, t.T @ w
        w, t = y[n:], trials[n:]  # beside the frame's basis there is nothing but noise
        square, gram, along = square + np.einsum("ik,ik->k", w, w), gram + t.T @ t, along + t.T @ w
        parts = row.turned @ white
        w, t = parts[:, :k], parts[:, k:]
        scales = np.array([self.scales_at((i, j))[1] for j in range(GRID.size)])[:, None]
        shares = scales / (1.0 + scales * row.square)
        log_det = row.log_det + np.sum(np.log1p(scales * row.square), axis=1)
        plain = -0.5 * (square - shares @ (w * w) + log_det[:, None])
        out = []
        for share, own in zip(shares, plain, strict=True):
            weighed = share[:, None] * t
            out.append(Seen(own, gram - t.T @ weighed, along - weighed.T @ w))
        return out

    def drawn(self, cell: Cell, rng: np.random.Generator, count: int) -> FloatArray:
        """Residuals (m, count) such as a pair of scales makes expect."""
        factor = self.reduced.covariance.factor(self.scales_at(cell))
        assert factor is not None
        out = rng.standard_normal((self.reduced.z.size, count))
        out[: len(factor)] = factor @ out[: len(factor)]
        return out

    def evidence(self, columns: Sequence[int] = ()) -> float:
        """Log of the likelihood of all data with some trial columns free, scales profiled."""
        i, j = self.summit(columns)
        return self.values(i, columns)[j] - 0.5 * self.reduced.extra

    def evidence_less_each(self) -> list[float]:
        """Log of the likelihood of the data less a trial, as it is, for each of the trials."""
        left = self.reduced.z[:, None] - self.reduced.trials
        best = np.full(left.shape[1], -np.inf)
        for i in range(GRID.size):
            for seen in self.seen(i, left, NONE):
                best = np.maximum(best, seen.plain)
        return [float(value) for value in best - 0.5 * self.reduced.extra]

    def plain(self, columns: Sequence[int] = ()) -> float:
        """The same of least squares, as if nothing but noise would be left."""
        return self.values(0, columns)[0]

    def best_scales(self, columns: Sequence[int] = ()) -> tuple[float, float]:
        """Profiled scales with some trial columns free."""
        return self.scales_at(self.summit(columns))

    def grid(self, columns: Sequence[int] = ()) -> dict[tuple[float, float], float]:
        """Log-likelihood of every pair of scales with some trial columns free, of the residual."""
        return {
            self.scales_at((i, j)): value
            for i in range(GRID.size) for j, value in enumerate(self.values(i, columns))
        }  # fmt: skip

    def summit(self, columns: Sequence[int] = ()) -> Cell:
        """Where on the grid the likelihood of the residual is largest, with some columns free.

        Climbed over the scale of the fine thresholds, with that of the dictionary profiled.
        """
        values: dict[int, list[float]] = {}

        def best(i: int) -> float:
            if i not in values:
                values[i] = self.values(i, columns)
            return max(values[i])

        at = max(STARTS, key=best)
        while True:
            beside = [i for i in (at, at - 1, at + 1) if 0 <= i < GRID.size]
            up = max(beside, key=best)
            if up == at:
                return at, int(np.argmax(values[at]))
            at = up

    def values(self, i: int, columns: Sequence[int] = ()) -> list[float]:
        """Log-likelihood of the residual along the grid, but for `Reduced.extra`."""
        if i not in self._known:
            self._known[i] = self.seen(i, self.reduced.z[:, None])
        seen = self._known[i]
        if not seen:
            return [-np.inf] * GRID.size
        plain = np.array([s.plain[0] for s in seen])
        if len(columns):
            k = np.array(columns)
            gram = np.array([s.gram[k[:, None], k] for s in seen])
            plain = plain + 0.5 * followed(gram, np.array([s.along[k] for s in seen]))[:, 0]
        return [float(value) for value in plain]


def followed(gram: FloatArray, along: FloatArray) -> FloatArray:
    """Squared lengths (h, k) from Gram matrices (h, n, n) and products (h, n, k)."""
    size = np.sqrt(np.diagonal(gram, axis1=1, axis2=2))
    unit = 1.0 / np.where(size > 0, size, 1.0)
    along = along * unit[:, :, None]
    if gram.shape[1] == 1:
        return np.asarray(along[:, 0] ** 2)
    value, vector = np.linalg.eigh(gram * unit[:, :, None] * unit[:, None, :])
    good = value > SAME**2 * value[:, -1:]
    share = np.where(good, 1.0 / np.where(good, value, 1.0), 0.0)
    return np.asarray(np.sum(share[:, :, None] * (vector.transpose(0, 2, 1) @ along) ** 2, axis=1))
