"""Everything about a point in a basis of what the base model cannot follow.

A frame is reduced once for all points that share it; a point adds the few directions that only its
own columns have. Of what the base cannot follow, fine thresholds and dictionary have a covariance,
which the two scales set; everything else is noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack, qr

from piezo_rig.diagnosis.linear import Frame, Linear, Pieces, summed

FloatArray = NDArray[np.float64]
BASE_CUT = 1e-9  # squared length of a base column of unit length that is no direction any more
KEEP = 1e-7  # the same of the columns that are left: rounding has taken its share of them
ROUNDED = 1e-7  # the same, of what they were before anything was projected off
KEPT = 64  # reductions of a frame


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


@dataclass(frozen=True, eq=False)
class Reduced:
    """Everything about one point in an orthonormal basis of what the base cannot follow.

    Attributes
    ----------
    fine, generic : shapes (n, f) and (n, u), of the first n of the basis
    trials : shape (m, t)
    z : shape (m,), the residual
    extra : scalar, squared length of the residual outside of the basis
    unit_fine, unit_generic : variance at which the set explains as much as the noise, on average
    most : variances of both that are not exceeded
    covariance : of the first n of the residual; the same object for all residuals, and for all
        points, that share their columns
    """

    fine: FloatArray
    generic: FloatArray
    trials: FloatArray
    z: FloatArray
    extra: float
    unit_fine: float
    unit_generic: float
    most: tuple[float, float]
    covariance: Covariance


@dataclass(frozen=True, eq=False)
class Shared:
    """How the columns of a `Frame` are reduced, for all points.

    Attributes
    ----------
    gram : shape (b + m, b + m)
    base, rest : which columns are projected off, and which are left
    off : shape (d, base), the base's orthonormal directions
    cross : shape (d, rest), what the columns that are left have of them
    axes : shape (n, rest), the orthonormal basis of what is then left of those
    fine, generic, unit_fine, unit_generic : as of `Reduced`
    """

    gram: FloatArray
    base: NDArray[np.int64]
    rest: NDArray[np.int64]
    off: FloatArray
    cross: FloatArray
    axes: FloatArray
    fine: FloatArray
    generic: FloatArray
    unit_fine: float
    unit_generic: float
    _covariances: dict[bytes, Covariance] = field(default_factory=dict)

    def covariance(self, law: FloatArray) -> Covariance:
        """With what assumed laws leave open; that of the latest law is kept."""
        key = law.tobytes()
        if key not in self._covariances:
            self._covariances.clear()
            self._covariances[key] = Covariance(self.fine, self.generic, _open(self.generic, law))
        return self._covariances[key]


@dataclass(frozen=True, eq=False)
class Axes:
    """How the columns of a `Linear` are reduced, whatever the residual.

    Attributes
    ----------
    shared : of its frame
    own : which of the own columns, in the order of the residual, follow
    followed, inside : shapes (d, k) and (n, k), what those have of the base's directions and of
        the frame's basis
    takes : shape (r, k), further directions that only they have
    turn : shape (n + r, m), what is left of basis and directions once some of them are taken off;
        None where none is
    reduced : everything but the residual
    """

    shared: Shared
    own: NDArray[np.int64]
    followed: FloatArray
    inside: FloatArray
    takes: FloatArray
    turn: FloatArray | None
    reduced: Reduced

    def with_residual(self, residual: FloatArray) -> Reduced:
        """The residual reduced as well, from its products (b + m + o + 1) as `Linear` has them."""
        shared = self.shared
        followed = shared.off @ residual[shared.base]
        z = shared.axes @ (residual[shared.rest] - shared.cross.T @ followed)
        left = residual[self.own] - self.followed.T @ followed - self.inside.T @ z
        z = np.concatenate([z, self.takes @ left])
        extra = max(float(residual[-1] - followed @ followed - z @ z), 0.0)
        return replace(self.reduced, z=z if self.turn is None else self.turn.T @ z, extra=extra)


def reduce(
    linear: Linear, pieces: Pieces = None, free: Sequence[int] = (), every: bool = False
) -> Reduced:
    """Project off base and powers and reduce.

    Parameters
    ----------
    pieces : which pieces' products to use; all by default
    free : base columns that are NOT projected off but handed on behind the trials, powers after
        all others
    every : with columns of the dictionary, too, that the model has a name for
    """
    unknown = None if every else linear.unknown
    key = (None if pieces is None else tuple(pieces), tuple(free), unknown is None)
    if key not in linear.axes:
        linear.axes[key] = _axes(linear, pieces, free, unknown)
    axes: Axes = linear.axes[key]
    return axes.with_residual(summed(linear.residual, pieces))


def _axes(
    linear: Linear, pieces: Pieces, free: Sequence[int], unknown: FloatArray | None
) -> Axes:
    lay, frame = linear.layout, linear.frame
    b, p = frame.compliances, lay.base
    size = b + sum(frame.counts)
    # where a base column is among the residual's products: own columns are behind the frame's
    place = {i: i if i < b else size + i - b if i < p else b + i - p for i in free}
    shared = reduced_frame(frame, pieces, tuple(j for j in place.values() if j < size))
    off = [size + i - b for i in range(b + lay.twice, p) if i not in place]
    trials = size + p - b + np.arange(lay.trials)
    columns = np.array([*off, *trials, *place.values()], int)
    mine, theirs = columns >= size, columns < size
    cross = np.empty((columns.size, size))
    cross[mine] = summed(linear.cross, pieces)[columns[mine] - size]
    cross[theirs] = shared.gram[columns[theirs]]
    gram = np.empty((columns.size, columns.size))
    gram[:, theirs], gram[theirs] = cross[:, columns[theirs]], cross[:, columns[theirs]].T
    own = columns[mine] - size
    gram[np.ix_(mine, mine)] = summed(linear.own, pieces)[np.ix_(own, own)]
    followed = shared.off @ cross[:, shared.base].T
    left = gram - followed.T @ followed
    inside = shared.axes @ (cross[:, shared.rest].T - shared.cross.T @ followed)
    length = np.sqrt(np.maximum(np.diag(left), 0.0))
    takes, outside = _orthonormal(left - inside.T @ inside, KEEP, length)
    coordinates, turn = np.concatenate([inside, outside]), None
    fine, generic = shared.fine, shared.generic
    covariance = shared.covariance(linear.law)
    law = _open(generic, linear.law)
    if unknown is not None:
        generic = generic * unknown
        covariance = Covariance(fine, generic, law)
    if off:
        unit = coordinates[:, : len(off)] / _unit_of(gram)[: len(off)]
        turn = _beside(unit)
        fine, generic, law = (turn[: len(x)].T @ x for x in (fine, generic, law))
        covariance = Covariance(fine, generic, law)
        coordinates = turn.T @ coordinates
    return Axes(shared, columns, followed, inside, takes, turn, Reduced(
        fine, generic, coordinates[:, len(off) :], np.zeros(0), 0.0, shared.unit_fine,
        shared.unit_generic, linear.most, covariance,
    ))  # fmt: skip


def reduced_frame(frame: Frame, pieces: Pieces = None, freed: tuple[int, ...] = ()) -> Shared:
    """Bands and powers but those that are freed projected off the frame; known ones are kept."""
    key = (None if pieces is None else tuple(pieces), freed)
    if key in frame.reduced:
        found: Shared = frame.reduced[key]
        return found
    while len(frame.reduced) >= KEPT:
        frame.reduced.pop(next(iter(frame.reduced)))
    gram, (powers, f, u) = frame.gram(pieces), frame.counts
    base = np.setdiff1d(np.arange(frame.compliances + powers), np.array(freed, int))
    rest = frame.compliances + powers + np.arange(f + u)
    columns = gram[np.ix_(rest, rest)]
    off, cross = np.zeros((0, 0)), np.zeros((0, rest.size))
    if base.size:
        off, _ = _orthonormal(gram[np.ix_(base, base)], BASE_CUT)
        cross = off @ gram[np.ix_(base, rest)]
        columns = columns - cross.T @ cross
    axes, inside = _orthonormal(columns, KEEP, _least(columns, gram[np.ix_(rest, rest)]))
    frame.reduced[key] = Shared(
        gram, base, rest, off, cross, axes, inside[:, :f], inside[:, f:],
        _unit(columns[:f, :f], len(axes)), _unit(columns[f:, f:], len(axes)),
    )  # fmt: skip
    return frame.reduced[key]


def _open(generic: FloatArray, law: FloatArray) -> FloatArray:
    """Standard deviations (n, k) of what assumed laws leave open."""
    return np.asarray(generic[:, law > 0] * np.sqrt(law[law > 0]))


def _beside(columns: FloatArray) -> FloatArray:
    """An orthonormal basis (n, m) of what is beside columns (n, k) of unit length at first."""
    q, r, _ = qr(columns, pivoting=True)
    size = np.square(np.diag(r))
    return np.asarray(q[:, int(np.sum(size > BASE_CUT)) :])


def _unit_of(gram: FloatArray) -> FloatArray:
    length = np.sqrt(np.maximum(np.diag(gram), 0.0))
    length[length == 0.0] = 1.0
    return length


def _orthonormal(
    gram: FloatArray, cut: float, length: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """An orthonormal basis of columns, from their Gram matrix (n, n); both shapes (m, n).

    First what each direction takes of which column, then the columns in it. Columns of which less
    than ``cut`` (squared) of their ``length`` is left by those before are no directions: a Cholesky
    factor with pivots, for a basis of eigenvectors takes ten times as long.
    """
    if gram.size == 0:
        return np.zeros((0, len(gram))), np.zeros((0, len(gram)))
    length = _unit_of(gram) if length is None else np.where(length > 0.0, length, 1.0)
    upper, pivots, rank, _ = lapack.dpstrf(gram / np.outer(length, length), tol=cut)
    if rank == 0:
        return np.zeros((0, len(gram))), np.zeros((0, len(gram)))
    pivots, upper = pivots - 1, np.triu(upper[:rank])
    inverse, _ = lapack.dtrtri(upper[:, :rank])
    takes, columns = np.zeros((rank, len(gram))), np.empty((rank, len(gram)))
    takes[:, pivots[:rank]] = inverse.T
    columns[:, pivots] = upper
    return takes / length, columns * length


def _least(left: FloatArray, gram: FloatArray) -> FloatArray:
    """Lengths (n,) of which `KEEP` is left at least of whatever is a direction.

    What is left of columns, by their Gram matrices after and before projection, is known to a
    share of what they were: Gram matrices square the condition of the base.
    """
    square = np.maximum(np.diag(left), ROUNDED / KEEP * np.diag(gram))
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def _unit(gram: FloatArray, rank: int) -> float:
    """Variance at which the strongest tenth of the directions stand out of the noise."""
    values = np.linalg.eigvalsh(gram)[::-1] if gram.size else np.zeros(1)
    return 1.0 / max(float(np.mean(values[: max(3, min(rank, values.size) // 10)])), 1e-300)


def covariance_of(reduced: Reduced, scales: tuple[float, float]) -> FloatArray:
    """Noise, fine thresholds and dictionary together, shape (m, m)."""
    n = len(reduced.fine)
    out = np.eye(reduced.z.size)
    out[:n, :n] = reduced.covariance.of(scales)
    return out
