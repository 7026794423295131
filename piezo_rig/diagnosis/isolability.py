"""What can be told from what under the protocol that was played: every cause against every other.

One signature to a cause, all of them about the final model: of a finding, what the model does
beyond the model without it; of a cause that was not found, the example that these data show best.
Everything that was fitted is projected off, but for the parameters of the two causes compared.
`confusion` asks the same of one finding with more care (it looks anew without it); this is the
map, for about the price of one scan.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.chain import Model
from piezo_rig.diagnosis.confusion import APART, about_less, own_columns, whitened
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.reduction import Reduced, covariance_of, reduce
from piezo_rig.diagnosis.refit import Fitted, changed_um, settle
from piezo_rig.diagnosis.scan import VISIBLE, candidates, of_base
from piezo_rig.diagnosis.space import Space

FloatArray = NDArray[np.float64]
SAME = 1e-3  # singular values below this share of the largest are no direction of their own


@dataclass(frozen=True, eq=False)
class Workings:
    """What a report draws from.

    Attributes
    ----------
    groups : of every rung, the recordings as they were then (spikes out, hum off), baseline first;
        the same drives and blocks in all
    space, last : of the last rung
    """

    groups: tuple[Groups, ...]
    space: Space
    last: Fitted


@dataclass(frozen=True, eq=False)
class Isolability:
    """The map of what can be told from what.

    Attributes
    ----------
    causes : findings in the order of the model, then what was not found but could be seen
    found : shape (c,), whether it is in the model
    d_prime : shape (c,), of a finding at its size, of the others at their largest plausible one
    size_nm : shape (c,), rms of that change of the displacement
    cosine : shape (c, c), of the row's signature with what the column's cause can do; 1 on the
        diagonal
    apart : shape (c, c), d' that is left of the row once the column is allowed for
    """

    causes: tuple[str, ...]
    found: NDArray[np.bool_]
    d_prime: FloatArray
    size_nm: FloatArray
    cosine: FloatArray
    apart: FloatArray

    @property
    def told(self) -> NDArray[np.bool_]:
        """Whether the row's cause is told from the column's, shape (c, c)."""
        return np.asarray(self.apart >= APART)


def isolability(space: Space, fitted: Fitted) -> Isolability:
    """Cosines among all causes that these data could show, about the final model."""
    settle(space, fitted.point)
    point, model = fitted.point, fitted.point.model
    members = [
        s.id for s in model.stages
        if isinstance(s, Cause) and not s.of_base and own_columns(point, s.id)
    ]
    pairs: list[tuple[Model, Model]] = [(model.without(c), model) for c in members]
    forms: dict[str, list[list[int]]] = {c: [[i]] for i, c in enumerate(members)}
    for candidate in candidates(space, model)[0]:
        if of_base(candidate.id):
            continue
        forms[candidate.id] = candidate.columns(len(pairs))
        pairs += candidate.pairs(model)
    own: list[int] = []
    at: dict[str, list[int]] = {}
    for c in members:
        columns = own_columns(point, c)
        at[c] = list(range(len(pairs) + len(own), len(pairs) + len(own) + len(columns)))
        own += columns
    reduced = reduce(space.linear(point, pairs), free=own)
    sigma = covariance_of(reduced, fitted.scales)
    every = tuple(k for c in members for k in at[c])
    plain = _White(reduced.trials, sigma)
    best: dict[str, int] = {c: forms[c][0][0] for c in members}
    seen, alone = _norm(plain.off(every)), _norm(_off(reduced.trials, every))
    for c in [c for c in forms if c not in members]:
        best[c] = max((k for form in forms[c] for k in form), key=lambda k: float(seen[k]))
        if alone[best[c]] * _largest(c) < VISIBLE:
            del forms[c], best[c]
    causes = tuple(forms)
    size, d_prime = np.zeros(len(causes)), np.zeros(len(causes))
    cosine, apart = np.eye(len(causes)), np.zeros((len(causes), len(causes)))
    for i, c in enumerate(causes):
        mine = c in members
        white = _with_priors(fitted, reduced, plain, c, at[c]) if mine else plain
        fitted_too = tuple(k for o in members if o != c for k in at[o])
        times = 1.0 if mine else _largest(c)
        d_prime[i] = times * _norm(white.off(fitted_too))[best[c]]
        size[i] = times * 1e3 * changed_um(space, *pairs[best[c]])
        for j, o in enumerate(causes):
            if i == j:
                continue
            # what is compared must not have been taken off before
            left = white.off(tuple(k for k in fitted_too if k not in at.get(o, ())))
            delta = left[:, best[c]]
            x = cosine[i, j] = _cosine(delta, left, forms[o])
            apart[i, j] = times * np.sqrt(max(1.0 - x * x, 0.0) * (delta @ delta))
        if mine and CAUSES[c].has_elements:
            d_prime[i], cosine[i], apart[i] = _of_a_table(space, fitted, c, forms, members, pairs)
    found = np.array([c in members for c in causes], bool)
    return Isolability(causes, found, d_prime, size, cosine, apart)


def _of_a_table(
    space: Space, fitted: Fitted, cause: str, forms: Mapping[str, list[list[int]]],
    members: Sequence[str], pairs: Sequence[tuple[Model, Model]],
) -> tuple[float, FloatArray, FloatArray]:
    """d', cosines and what is left of it beside every other cause: see `about_less`."""
    less = fitted.point.without(cause)
    linear = about_less(space, fitted.point, cause, pairs)
    cosine, apart = np.ones(len(forms)), np.zeros(len(forms))
    d_prime = _norm(whitened(reduce(linear), fitted.scales)[:, 0])
    for j, (other, columns) in enumerate(forms.items()):
        if other != cause:
            free = own_columns(less, other) if other in members else []
            white = whitened(reduce(linear, free=free), fitted.scales)
            behind = [[k + 1 for k in form] for form in columns]
            x = cosine[j] = _cosine(white[:, 0], white, behind)
            apart[j] = np.sqrt(max(1.0 - x * x, 0.0)) * _norm(white[:, 0])
    settle(space, fitted.point)
    return float(d_prime), cosine, apart


class _White:
    """Whitened columns; what is left of them once some are taken off is kept."""

    def __init__(self, columns: FloatArray, sigma: FloatArray) -> None:
        self.columns, self.sigma = columns, sigma
        self.white = solve_triangular(cholesky(sigma, lower=True), columns, lower=True)
        self._known: dict[tuple[int, ...], FloatArray] = {(): self.white}

    def off(self, taken: tuple[int, ...]) -> FloatArray:
        if taken not in self._known:
            self._known[taken] = _off(self.white, taken)
        return self._known[taken]


def _with_priors(
    fitted: Fitted, reduced: Reduced, plain: _White, cause: str, columns: Sequence[int]
) -> _White:
    """The same with what the cause's own assumed law leaves open in the covariance."""
    kind = CAUSES[cause]
    assert issubclass(kind, Cause)
    sigma = plain.sigma
    names = [name for id, name in fitted.point.names if id == cause]
    for k, name in zip(columns, names, strict=False):  # parameters come before a table
        if name in kind.priors:
            column = kind.priors[name][1] * reduced.trials[:, k]
            sigma = sigma + np.outer(column, column)
    return plain if sigma is plain.sigma else _White(reduced.trials, sigma)


def _off(white: FloatArray, columns: Sequence[int]) -> FloatArray:
    """All columns less what some of them can do."""
    u = _directions(white[:, list(columns)], 1e-6)
    return np.asarray(white - u @ (u.T @ white))


def _directions(columns: FloatArray, cut: float) -> FloatArray:
    norm = _norm(columns)
    if columns.shape[1] == 0:
        return columns
    good = norm > 1e-9 * max(float(norm.max()), 1e-300)
    u, s, _ = np.linalg.svd(columns[:, good] / norm[good], full_matrices=False)
    return np.asarray(u[:, s > cut * s[0]]) if s.size else np.zeros((columns.shape[0], 0))


def _cosine(delta: FloatArray, white: FloatArray, forms: list[list[int]]) -> float:
    size, best = max(float(np.sqrt(delta @ delta)), 1e-300), 0.0
    lone = [form[0] for form in forms if len(form) == 1]
    if lone:
        norm = np.maximum(_norm(white[:, lone]), 1e-300)
        best = float(np.max(np.abs(delta @ white[:, lone]) / norm)) / size
    for form in forms:
        if len(form) > 1:
            inside = _directions(white[:, form], SAME).T @ delta
            best = max(best, float(np.sqrt(inside @ inside)) / size)
    return min(best, 1.0)


def _norm(columns: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.sum(columns**2, axis=0)))


def _largest(cause: str) -> float:
    kind = CAUSES[cause]
    assert issubclass(kind, Cause)
    return kind.largest
