"""Marginal likelihoods on reduced columns: the score of every cause, and its calibration.

What the base model can follow is projected out. In what is left the residual is

    z = T_c b + F a + U g + e,    a ~ N(0, s1), g ~ N(0, s2), e ~ N(0, 1)

with T_c a cause's signatures, F the fine thresholds and U the generic dictionary (base mismatch,
and the rival "nobody has a name for it"). The scales s1, s2 are profiled anew under every
hypothesis; the null distribution of each cause's likelihood ratio comes from data simulated from
the fitted null, its tail from a gamma law.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.linalg import cholesky, solve_triangular

from piezo_rig.diagnosis.space import Linear

FloatArray = NDArray[np.float64]
NULLS = 200
BASE_CUT = 1e-11  # eigenvalues of the scaled base Gram below this are not directions of it
KEEP = 1e-9
GRID = np.concatenate([[0.0], 7.0 ** np.arange(-1.0, 6.0)])  # of variance, in units below


@dataclass(frozen=True, eq=False)
class Reduced:
    """Everything about one point in an orthonormal basis of what the base cannot follow.

    Attributes
    ----------
    fine, generic : shapes (m, f) and (m, u)
    trials : shape (m, t)
    law : shape (m, k), standard deviations of what assumed laws leave open
    z : shape (m,), the residual
    extra : scalar, squared length of the residual outside of the basis
    unit_fine, unit_generic : variance at which the set explains as much as the noise, on average
    """

    fine: FloatArray
    generic: FloatArray
    trials: FloatArray
    law: FloatArray
    z: FloatArray
    extra: float
    unit_fine: float
    unit_generic: float


def reduce(
    linear: Linear, pieces: Sequence[int] | None = None, free: Sequence[int] = ()
) -> Reduced:
    """Project off base and powers and reduce.

    Parameters
    ----------
    pieces : which pieces' Gram matrices to use; all by default
    free : base columns that are NOT projected off but handed on behind the trials
    """
    gram = (linear.white if pieces is None else linear.white[list(pieces)]).sum(axis=0)
    lay = linear.layout
    all_base = np.delete(np.arange(lay.base + lay.powers), lay.base + np.arange(lay.twice))
    base = np.setdiff1d(all_base, np.asarray(free, int))
    rest = np.concatenate([
        np.arange(lay.part("fine").start, lay.part("trials").start),
        np.arange(*lay.part("trials").indices(10**9)), np.asarray(free, int),
        [gram.shape[0] - 1],
    ]).astype(int)  # fmt: skip
    left = gram[np.ix_(rest, rest)]
    if base.size:
        scale = 1.0 / np.sqrt(np.maximum(np.diag(gram)[base], 1e-300))
        b = gram[np.ix_(base, base)] * np.outer(scale, scale)
        value, vector = np.linalg.eigh(b)
        good = value > BASE_CUT * value[-1]
        half = (vector[:, good] / np.sqrt(value[good])).T * scale
        cross = half @ gram[np.ix_(base, rest)]
        left = left - cross.T @ cross
    f, u = lay.fine, lay.generic
    columns = left[:-1, :-1]
    size = np.sqrt(np.maximum(np.diag(columns), 0.0))
    norm = np.where(size > 0, size, 1.0)
    value, vector = np.linalg.eigh(columns / np.outer(norm, norm))
    good = value > KEEP * max(value[-1], 1e-300)
    axes = vector[:, good] / np.sqrt(value[good])
    coordinates = (axes / norm[:, None]).T @ columns
    z = (axes / norm[:, None]).T @ left[:-1, -1]
    fine, generic = coordinates[:, :f], coordinates[:, f : f + u]

    def unit(x: FloatArray) -> float:
        # variance at which the strongest tenth of the directions stand out of the noise
        values = np.linalg.svd(x, compute_uv=False) ** 2 if x.size else np.zeros(1)
        return 1.0 / max(float(np.mean(values[: max(3, values.size // 10)])), 1e-300)

    return Reduced(
        fine, generic, coordinates[:, f + u :],
        generic[:, linear.law > 0] * np.sqrt(linear.law[linear.law > 0]),
        z, max(float(left[-1, -1] - z @ z), 0.0),
        unit(fine), unit(generic),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Scored:
    """Log-likelihood ratios of several causes against the same null.

    Attributes
    ----------
    ratio : shape (c,), log-likelihood gained
    p_value : shape (c,), from the gamma tail of the simulated nulls; not corrected
    null_median : shape (c,)
    chosen : shape (c,), the best hypothesis of each cause
    scales : null's scales (s1, s2)
    scales_with : shape (c, 2), under each cause
    """

    ratio: FloatArray
    p_value: FloatArray
    null_median: FloatArray
    chosen: NDArray[np.int64]
    scales: tuple[float, float]
    scales_with: FloatArray


class Likelihood:
    """Factors of the covariance on a grid of scales, for one reduced problem."""

    def __init__(self, reduced: Reduced, generic: bool = True) -> None:
        self.reduced = reduced
        first = reduced.fine @ reduced.fine.T
        second = reduced.generic @ reduced.generic.T
        self.grid: list[tuple[float, float]] = []
        self.factor: list[FloatArray] = []
        self.logdet: list[float] = []
        eye = np.eye(reduced.z.size) + reduced.law @ reduced.law.T
        for a in GRID * reduced.unit_fine:
            for b in GRID * reduced.unit_generic if generic else (0.0,):
                try:
                    lower = cholesky(eye + a * first + b * second, lower=True, check_finite=False)
                except np.linalg.LinAlgError:  # scales so far apart that rounding decides
                    continue
                self.grid.append((float(a), float(b)))
                self.factor.append(lower)
                self.logdet.append(2.0 * float(np.sum(np.log(np.diag(lower)))))

    def score(
        self,
        hypotheses: Sequence[Sequence[int]],
        owners: Sequence[int],
        rng: np.random.Generator,
        nulls: int = NULLS,
    ) -> Scored:
        """Score causes, each with one or several sets of trial columns of which the best counts.

        ``owners`` : for every hypothesis the number of its cause, 0, 1, ..
        """
        _, at = self._profile(self.reduced.z[:, None], ())
        k = int(at[0])
        drawn = self.factor[k] @ rng.standard_normal((self.reduced.z.size, nulls))
        y = np.concatenate([self.reduced.z[:, None], drawn], axis=1)
        best_null = np.full(y.shape[1], -np.inf)
        best = np.full((len(hypotheses), y.shape[1]), -np.inf)
        where = np.zeros(len(hypotheses), int)
        alone = [h for h, columns in enumerate(hypotheses) if len(columns) == 1]
        several = [h for h, columns in enumerate(hypotheses) if len(columns) > 1]
        for g, lower in enumerate(self.factor):
            both = solve_triangular(
                lower,
                np.concatenate([y, self.reduced.trials], axis=1),
                lower=True,
                check_finite=False,
            )
            w, t = both[:, : y.shape[1]], both[:, y.shape[1] :]
            plain = -0.5 * (np.sum(w * w, axis=0) + self.logdet[g])
            best_null = np.maximum(best_null, plain)
            gained = np.empty_like(best)
            ones = t[:, [hypotheses[h][0] for h in alone]]
            size = np.sqrt(np.sum(ones * ones, axis=0))
            gained[alone] = ((ones / np.where(size > 0, size, 1.0)).T @ w) ** 2
            for h in several:
                q = _orthonormal(t[:, list(hypotheses[h])])
                gained[h] = np.sum((q.T @ w) ** 2, axis=0)
            value = plain + 0.5 * gained
            where[value[:, 0] > best[:, 0]] = g
            best = np.maximum(best, value)
        owner = np.asarray(owners, int)
        causes = int(owner.max()) + 1
        ratio = np.full((causes, y.shape[1]), -np.inf)
        np.maximum.at(ratio, owner, best - best_null)
        chosen = np.array(
            [int(np.flatnonzero(owner == c)[np.argmax(best[owner == c, 0])]) for c in range(causes)]
        )
        return Scored(
            ratio[:, 0],
            np.array([tail(r[0], r[1:]) for r in ratio]),
            np.median(ratio[:, 1:], axis=1),
            chosen,
            self.grid[k],
            np.array([self.grid[where[h]] for h in chosen]).reshape(-1, 2),
        )

    def score_generic(self, rng: np.random.Generator, nulls: int = NULLS) -> tuple[float, float]:
        """Log-likelihood ratio of the dictionary's scale against 0, and its p-value."""
        zero = [i for i, (_, b) in enumerate(self.grid) if b == 0.0]
        value = np.array([self._value(i, self.reduced.z[:, None])[0] for i in zero])
        k = zero[int(np.argmax(value))]
        y = np.concatenate(
            [
                self.reduced.z[:, None],
                self.factor[k] @ rng.standard_normal((self.reduced.z.size, nulls)),
            ],
            axis=1,
        )
        null = np.full(y.shape[1], -np.inf)
        full = np.full(y.shape[1], -np.inf)
        for g in range(len(self.factor)):
            v = self._value(g, y)
            full = np.maximum(full, v)
            if self.grid[g][1] == 0.0:
                null = np.maximum(null, v)
        ratio = full - null
        return float(ratio[0]), tail(float(ratio[0]), ratio[1:])

    def evidence(self, columns: Sequence[int] = ()) -> float:
        """Log of the likelihood of all data with some trial columns free, scales profiled."""
        values, _ = self._profile(self.reduced.z[:, None], columns)
        return float(values[0]) - 0.5 * self.reduced.extra

    def best_scales(self, columns: Sequence[int] = ()) -> tuple[float, float]:
        """Profiled scales with some trial columns free."""
        _, at = self._profile(self.reduced.z[:, None], columns)
        return self.grid[int(at[0])]

    def _profile(
        self, y: FloatArray, columns: Sequence[int]
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        values = np.array([self._value(g, y, columns) for g in range(len(self.factor))])
        return values.max(axis=0), values.argmax(axis=0)

    def _value(self, g: int, y: FloatArray, columns: Sequence[int] = ()) -> FloatArray:
        w = solve_triangular(self.factor[g], y, lower=True, check_finite=False)
        value = -0.5 * (np.sum(w * w, axis=0) + self.logdet[g])
        if len(columns):
            t = solve_triangular(
                self.factor[g],
                self.reduced.trials[:, list(columns)],
                lower=True,
                check_finite=False,
            )
            value = value + 0.5 * np.sum((_orthonormal(t).T @ w) ** 2, axis=0)
        return np.asarray(value)


def _orthonormal(columns: FloatArray) -> FloatArray:
    norm = np.sqrt(np.sum(columns**2, axis=0))
    good = norm > 0
    if not np.any(good):
        return np.zeros((columns.shape[0], 0))
    u, s, _ = np.linalg.svd(columns[:, good] / norm[good], full_matrices=False)
    return u[:, s > 1e-4 * s[0]]


def tail(value: float, nulls: FloatArray) -> float:
    """Chance of a value at least this large, from a gamma law through the nulls' moments."""
    x = np.maximum(nulls, 0.0)
    mean, spread = float(x.mean()), float(x.std(ddof=1))
    if value <= 0.0:
        return 1.0
    if mean <= 0.0 or spread <= 0.0:
        return 1.0 / (nulls.size + 1)
    # moments wobble: the tail is taken a little heavier than they say
    spread *= 1.0 + 1.0 / np.sqrt(2.0 * nulls.size)
    shape = (mean / spread) ** 2
    p = float(stats.gamma.sf(value, shape, scale=spread**2 / mean))
    return max(p, 1e-300)
