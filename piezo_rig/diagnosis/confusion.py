"""What these data cannot tell apart: d' of a finding, and the cosines with all other causes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.chain import Model
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.linear import Linear
from piezo_rig.diagnosis.reduction import Reduced, covariance_of, reduce
from piezo_rig.diagnosis.refit import Fitted, settle
from piezo_rig.diagnosis.scan import candidates, of_base
from piezo_rig.diagnosis.space import Space

FloatArray = NDArray[np.float64]
APART = 4.0


@dataclass(frozen=True)
class Confusion:
    """Of one finding.

    Attributes
    ----------
    d_prime : size of the finding over everything else that could be meant
    cosine : cause -> largest cosine with what that cause can do
    """

    d_prime: float
    cosine: dict[str, float]

    @property
    def alternatives(self) -> list[str]:
        """Causes that the data cannot tell from the finding (design 6.4)."""
        found = {c: self.d_prime * np.sqrt(max(1.0 - x * x, 0.0)) for c, x in self.cosine.items()}
        return sorted((c for c, apart in found.items() if apart < APART), key=lambda c: found[c])


def strengths(space: Space, fitted: Fitted, causes: Sequence[str]) -> dict[str, float]:
    """d' of several accepted causes, each as the whole model against the model without it."""
    point = fitted.point
    pairs = [(point.model.without(c), point.model) for c in causes]
    own = range(point.linear, point.linear + len(point.sizes))
    reduced = reduce(space.linear(point, pairs), free=own)
    white = whitened(reduced, fitted.scales)[:, : len(pairs)]
    return dict(zip(causes, np.sqrt(np.sum(white**2, axis=0)).tolist(), strict=True))


def certainties(space: Space, fitted: Fitted, causes: Sequence[str]) -> dict[str, float]:
    """d' of several accepted causes, each with everything else that was fitted projected off."""
    point, found = fitted.point, {}
    others = [c for c in causes if not CAUSES[c].has_elements]
    settle(space, point)
    linear = space.linear(point, [(point.model.without(c), point.model) for c in others])
    for k, cause in enumerate(others):
        reduced = reduce(linear, free=own_columns(point, cause))
        found[cause] = float(np.linalg.norm(whitened(reduced, fitted.scales)[:, k]))
    for cause in causes:
        if cause not in found:
            reduced = reduce(about_less(space, point, cause, []))
            found[cause] = float(np.linalg.norm(whitened(reduced, fitted.scales)[:, 0]))
    settle(space, point)
    return found


def whitened(reduced: Reduced, scales: tuple[float, float]) -> FloatArray:
    """All trial columns (m, t), whitened by noise and mismatch: their lengths are d'."""
    lower = cholesky(covariance_of(reduced, scales), lower=True)
    return np.asarray(solve_triangular(lower, reduced.trials, lower=True))


def about_less(
    space: Space, point: Point, cause: str, pairs: Sequence[tuple[Model, Model]]
) -> Linear:
    """What a table of its own does, and other changes, about the model without it.

    Beside it the base has a smooth density and fine thresholds of its own for a first rise, which
    nobody would have without it: they are its own, and not what it must stand out from.
    """
    less = point.without(cause)
    settle(space, less)
    return space.linear(less, [(less.model, point.model), *pairs])


def own_columns(point: Point, cause: str) -> list[int]:
    """Base columns that belong to a cause: its parameters, and its table if it is one."""
    own = [point.linear + j for j, (id, _) in enumerate(point.names) if id == cause]
    first = 0
    for stage in point.tables:
        assert stage.elements is not None
        if stage.id == cause:
            own += list(range(first, first + len(stage.elements)))
        first += len(stage.elements)
    return own


def confusion(space: Space, fitted: Fitted, cause: str) -> Confusion:
    """d' and cosines of an accepted cause about the full model.

    The signature is what the model with the cause does beyond the model without it, projected
    off everything else that was fitted; the finding's own parameters are not projected off, but
    what its assumed law leaves open is in the covariance.
    """
    model = fitted.point.model
    less = model.without(cause)
    pairs: list[tuple[Model, Model]] = [(less, model)]
    found, _ = candidates(space, less)
    columns: dict[str, list[list[int]]] = {}
    for c in found:
        if c.id == cause or model.stage(c.id) is not None or of_base(c.id):
            continue
        columns[c.id] = c.columns(len(pairs))
        pairs += c.pairs(less)
    point, kind = fitted.point, CAUSES[cause]
    if kind.has_elements:
        own = []
        linear = about_less(space, point, cause, pairs[1:])
        settle(space, point)
    else:
        own = own_columns(point, cause)
        linear = space.linear(point, pairs)
    reduced = reduce(linear, free=own)
    sigma = covariance_of(reduced, fitted.scales)
    assert issubclass(kind, Cause)
    handed = reduced.trials[:, len(pairs) :]
    for j, k in enumerate(own):
        if k >= point.linear:
            name = point.sizes[k - point.linear][1]
            if name in kind.priors and name not in kind.loosened:
                column = kind.priors[name][1] * handed[:, j]
                sigma = sigma + np.outer(column, column)
    lower = cholesky(sigma, lower=True)
    white = solve_triangular(lower, reduced.trials[:, : len(pairs)], lower=True)
    delta = white[:, 0]
    size = float(np.sqrt(delta @ delta))
    cosine = {}
    for id, sets in columns.items():
        best = 0.0
        for chosen in sets:
            norm = np.sqrt(np.sum(white[:, chosen] ** 2, axis=0))
            if not np.all(norm > 0):
                continue
            u, s, _ = np.linalg.svd(white[:, chosen] / norm, full_matrices=False)
            inside = u[:, s > 1e-3 * s[0]].T @ delta
            best = max(best, float(np.sqrt(inside @ inside)) / max(size, 1e-300))
        cosine[id] = min(best, 1.0)
    return Confusion(size, cosine)
