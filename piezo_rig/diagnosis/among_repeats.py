"""What recordings of one drive differ by, and which causes can make them differ so.

Whatever a base model gets wrong, it gets wrong in all of them alike. So what they differ by speaks
for a cause that makes them differ, without any regard to the base: an actuator that ages through
the session, a drift that settles. It is not in the evidence of a model, which is of their means.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.diagnosis.scan import candidates
from piezo_rig.diagnosis.space import Space

FloatArray = NDArray[np.float64]
PLAINLY = 20.0  # log-likelihood of the differences that no chance and no other cause comes near
LITTLE = 1e-3  # of the largest singular value: columns that repeat others


def told(space: Space, model: Model, less: Model) -> float:
    """By how much the differences are likelier with a model than with another, log-likelihood."""
    with_it, without = _said(space, model), _said(space, less)
    if with_it is None and without is None:
        return 0.0
    found = _measured(space)
    return _unlikely(found, without) - _unlikely(found, with_it)


def as_able(space: Space, model: Model, cause: str, others: Sequence[str]) -> list[str]:
    """Those of other causes that might explain the differences as a member of a model does.

    Each with whatever shares of all that it can do would explain most.
    """
    less, kept = model.without(cause), list(others)
    mine = _said(space, model) if others else None
    if mine is None:
        return kept
    found, base = _measured(space), _said(space, less)
    own = _unlikely(found, mine)
    if _unlikely(found, base) - own < PLAINLY:
        return kept
    left = found if base is None else found - base
    for other in candidates(space, less)[0]:
        if other.id not in kept:
            continue
        rows = [_said(space, m) for _, m in other.pairs(less)]
        made = np.array([r if base is None else r - base for r in rows if r is not None])
        if _unlikely(_beside(left, made), None) > own + PLAINLY:
            kept.remove(other.id)
    return kept


def _measured(space: Space) -> FloatArray:
    """Every recording beside the mean of those of its drive, one after the other, whitened."""
    return _white(space, [g.measured_um - g.measured_um.mean(axis=0) for g in space.groups.groups])


def _said(space: Space, model: Model) -> FloatArray | None:
    """The same of what a model says; None if that is nothing."""
    rows = [g.apart(model) for g in space.groups.groups]
    if all(r is None for r in rows):
        return None
    return _white(space, [
        np.zeros(g.measured_um.shape) if r is None else r
        for g, r in zip(space.groups.groups, rows, strict=True)
    ])  # fmt: skip


def _white(space: Space, every: Sequence[FloatArray]) -> FloatArray:
    groups, whitener = space.groups, space.whitener
    made = [np.zeros(0)]
    for g, rows in zip(groups.groups, every, strict=True):
        if g.repeats < 2:
            continue
        thin = groups.thinned(g, rows)
        for (a, b), cells in zip(groups.edges(g), groups.cells(g), strict=True):
            made.append(whitener.beside_offset(thin[:, a:b], cells).ravel())
    return np.concatenate(made)


def _unlikely(found: FloatArray, said: FloatArray | None) -> float:
    """Less log-likelihood, but for a constant."""
    left = found if said is None else found - said
    return 0.5 * float(left @ left)


def _beside(found: FloatArray, made: FloatArray) -> FloatArray:
    """What is left of a row (n,) by the best shares of others (k, n)."""
    if not made.size:
        return found
    shares = np.linalg.lstsq(made.T, found, rcond=LITTLE)[0]
    return found - shares @ made
