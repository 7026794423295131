"""Marginal likelihoods on reduced columns: the score of every cause, and its calibration.

What the base model can follow is projected out. In what is left the residual is

    z = T_c b + F a + U g + e,    a ~ N(0, s1), g ~ N(0, s2), e ~ N(0, 1)

with T_c a cause's signatures, F the fine thresholds and U the generic dictionary (base mismatch,
and the rival "nobody has a name for it"). The scales s1, s2 are profiled anew under every
hypothesis (`scores` compares them).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from piezo_rig.diagnosis.linear import Linear, summed

FloatArray = NDArray[np.float64]
BASE_CUT = 1e-9  # squared length of a base column of unit length that is no direction any more
KEEP = 1e-7  # the same of the columns that are left: rounding has taken its share of them
GRID = np.concatenate([[0.0], 7.0 ** np.arange(-1.0, 6.0)])  # of variance, in units below
Cell = tuple[int, int]  # of the grid of both scales
STARTS = (0, 4)  # scales of the fine thresholds that a climb looks at first
SAME = 1e-4  # of the largest singular value: columns that only repeat others


class Row(NamedTuple):
    """The covariance at one scale of the fine thresholds and none of the dictionary.

    ``lower`` (m, m) its Cholesky factor, ``log_det`` of it; ``turned`` (u, m) the dictionary's
    principal directions whitened by it, with their squared lengths ``square`` (u,)
    """

    lower: FloatArray
    log_det: float
    turned: FloatArray
    square: FloatArray


class Covariance:
    """Noise, fine thresholds, dictionary and assumed laws together, as the two scales say.

    One Cholesky factor per scale of the fine thresholds serves all scales of the dictionary: in
    its principal directions that only adds to a diagonal. They are kept.
    """

    def __init__(self, fine: FloatArray, generic: FloatArray, law: FloatArray) -> None:
        self._fine, self._generic = fine @ fine.T, generic
        self._rest = np.eye(fine.shape[0]) + law @ law.T
        self._rows: dict[float, Row | None] = {}

    def of(self, scales: tuple[float, float]) -> FloatArray:
        """Shape (m, m)."""
        out = scales[0] * self._fine
        out += self._rest
        if scales[1]:
            out += scales[1] * (self._generic @ self._generic.T)
        return out

    def factor(self, scales: tuple[float, float]) -> FloatArray | None:
        """Lower Cholesky factor (m, m); None where rounding decides whether there is one."""
        lower, bad = lapack.dpotrf(self.of(scales).T, lower=1, overwrite_a=1)
        return lower if bad == 0 else None

    def row(self, scale: float) -> Row | None:
        """For a scale of the fine thresholds; None where rounding decides."""
        if scale not in self._rows:
            lower = self.factor((scale, 0.0))
            self._rows[scale] = None if lower is None else self._row(lower)
        return self._rows[scale]

    def _row(self, lower: FloatArray) -> Row:
        white, _ = lapack.dtrtrs(lower, self._generic, lower=1)
        square, vector = np.linalg.eigh(white.T @ white)
        log_det = 2.0 * float(np.sum(np.log(np.diag(lower))))
        return Row(lower, log_det, vector.T @ white.T, np.maximum(square, 0.0))

    def forget(self) -> None:
        """Let go of what is kept."""
        self._rows.clear()


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
    most : variances of both that are not exceeded
    covariance : of the residual; the same object for every residual of the same columns
    """

    fine: FloatArray
    generic: FloatArray
    trials: FloatArray
    law: FloatArray
    z: FloatArray
    extra: float
    unit_fine: float
    unit_generic: float
    most: tuple[float, float]
    covariance: Covariance


@dataclass(frozen=True, eq=False)
class Axes:
    """How the columns of a `Linear` are reduced, whatever the residual.

    Attributes
    ----------
    base, rest : which columns are projected off, and which are left
    off : shape (d, base), the base's orthonormal directions
    cross : shape (d, rest), what the columns that are left have of them
    axes : shape (m, rest), the orthonormal basis of what is then left of those
    reduced : everything but the residual
    """

    base: NDArray[np.int64]
    rest: NDArray[np.int64]
    off: FloatArray
    cross: FloatArray
    axes: FloatArray
    reduced: Reduced

    def with_residual(self, residual: FloatArray) -> Reduced:
        """The residual reduced as well, from its products (c + 1,) as `Linear` has them."""
        followed = self.off @ residual[self.base]
        z = self.axes @ (residual[self.rest] - self.cross.T @ followed)
        extra = float(residual[-1] - followed @ followed - z @ z)
        return replace(self.reduced, z=z, extra=max(extra, 0.0))


def reduce(
    linear: Linear, pieces: Sequence[int] | None = None, free: Sequence[int] = ()
) -> Reduced:
    """Project off base and powers and reduce.

    Parameters
    ----------
    pieces : which pieces' Gram matrices to use; all by default
    free : base columns that are NOT projected off but handed on behind the trials
    """
    key = (None if pieces is None else tuple(pieces), tuple(free))
    if key not in linear.axes:
        linear.axes[key] = _axes(linear, summed(linear.white, pieces), free)
    axes: Axes = linear.axes[key]
    return axes.with_residual(summed(linear.residual, pieces))


def _axes(linear: Linear, gram: FloatArray, free: Sequence[int]) -> Axes:
    lay = linear.layout
    all_base = np.delete(np.arange(lay.base + lay.powers), lay.base + np.arange(lay.twice))
    base = np.setdiff1d(all_base, np.asarray(free, int))
    rest = np.concatenate([
        np.arange(lay.part("fine").start, lay.part("trials").stop), np.asarray(free, int),
    ]).astype(int)  # fmt: skip
    columns = gram[np.ix_(rest, rest)]
    off, cross = np.zeros((0, 0)), np.zeros((0, rest.size))
    if base.size:
        off, _ = _orthonormal(gram[np.ix_(base, base)], BASE_CUT)
        cross = off @ gram[np.ix_(base, rest)]
        columns = columns - cross.T @ cross
    f, u = lay.fine, lay.generic
    axes, coordinates = _orthonormal(columns, KEEP)
    fine, generic = coordinates[:, :f], coordinates[:, f : f + u]
    law = generic[:, linear.law > 0] * np.sqrt(linear.law[linear.law > 0])
    return Axes(base, rest, off, cross, axes, Reduced(
        fine, generic, coordinates[:, f + u :], law, np.zeros(0), 0.0,
        _unit(columns[:f, :f], len(axes)), _unit(columns[f : f + u, f : f + u], len(axes)),
        linear.most,
        Covariance(fine, generic, law),
    ))  # fmt: skip


def _orthonormal(gram: FloatArray, cut: float) -> tuple[FloatArray, FloatArray]:
    """An orthonormal basis of columns, from their Gram matrix (n, n); both shapes (m, n).

    First what each direction takes of which column, then the columns in it. Columns of unit length
    of which less than ``cut`` (squared) is left by those before are no directions: a Cholesky
    factor with pivots, for a basis of eigenvectors takes ten times as long.
    """
    length = np.sqrt(np.maximum(np.diag(gram), 0.0))
    length[length == 0.0] = 1.0
    upper, pivots, rank, _ = lapack.dpstrf(gram / np.outer(length, length), tol=cut)
    pivots, upper = pivots - 1, np.triu(upper[:rank])
    inverse, _ = lapack.dtrtri(upper[:, :rank])
    takes, columns = np.zeros((rank, len(gram))), np.empty((rank, len(gram)))
    takes[:, pivots[:rank]] = inverse.T
    columns[:, pivots] = upper
    return takes / length, columns * length


def _unit(gram: FloatArray, rank: int) -> float:
    """Variance at which the strongest tenth of the directions stand out of the noise."""
    values = np.linalg.eigvalsh(gram)[::-1] if gram.size else np.zeros(1)
    return 1.0 / max(float(np.mean(values[: max(3, min(rank, values.size) // 10)])), 1e-300)


def covariance_of(reduced: Reduced, scales: tuple[float, float]) -> FloatArray:
    """Noise, fine thresholds and dictionary together, shape (m, m)."""
    return reduced.covariance.of(scales)


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

    def seen(self, i: int, y: FloatArray) -> list[Seen]:
        """Data (m, k) and all trials at a scale of the fine thresholds and each of the dictionary.

        Empty where rounding decides.
        """
        row = self.reduced.covariance.row(self.scales_at((i, 0))[0])
        if row is None:
            return []
        k = y.shape[1]
        both = np.empty((y.shape[0], k + self.reduced.trials.shape[1]), order="F")
        both[:, :k], both[:, k:] = y, self.reduced.trials
        white, _ = lapack.dtrtrs(row.lower, both, lower=1, overwrite_b=1)
        w, t = white[:, :k], white[:, k:]
        square, gram, along = np.einsum("ik,ik->k", w, w), t.T @ t, t.T @ w
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
        return np.asarray(factor @ rng.standard_normal((self.reduced.z.size, count)))

    def evidence(self, columns: Sequence[int] = ()) -> float:
        """Log of the likelihood of all data with some trial columns free, scales profiled."""
        i, j = self.summit(columns)
        return self.values(i, columns)[j] - 0.5 * self.reduced.extra

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
