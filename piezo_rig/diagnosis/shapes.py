"""A cause in whichever of its shapes the data ask for, wherever each may begin.

Rates, thresholds and corners make laws that a descent from one of them does not lead to another.
So all of them are looked at about the model without the cause, each at the size that suits it, and
refitted where that look says as much as what was found.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from piezo_rig.causes.cause import Cause
from piezo_rig.chain import Stage
from piezo_rig.diagnosis.abreast import abreast
from piezo_rig.diagnosis.forms import FADES, summit
from piezo_rig.diagnosis.likelihood import Likelihood
from piezo_rig.diagnosis.reduction import Reduced, covariance_of, reduce
from piezo_rig.diagnosis.refit import Fitted, playable, refit_either_way, settle
from piezo_rig.diagnosis.space import Space
from piezo_rig.errors import InputError

PLAIN = 20.0  # log-likelihood of a cause whose shape may show
ABOUT_AS_GOOD = 5.0  # the same by which a look may be worse than that at what was found
SHAPES = 3  # that are refitted at most


def in_another_shape(space: Space, fitted: Fitted, id: str) -> Fitted:
    """In the shape that says most, where that is plainly more."""
    stage = fitted.point.model.stage(id)
    shapes = stage.shapes() if isinstance(stage, Cause) else {}
    if not shapes:
        return fitted
    less = fitted.point.without(id)
    settle(space, less)
    assert isinstance(stage, Cause)
    names = ["", *(name for name, own in shapes.items() for _ in own)]
    tried = [stage, *(s for own in shapes.values() for s in own)]
    kept = [k for k, s in enumerate(tried) if k == 0 or playable(space, less.model.with_stage(s))]
    names, tried = [names[k] for k in kept], [tried[k] for k in kept]
    pairs = [(less.model, less.model.with_stage(s)) for s in tried]
    likelihood = Likelihood(reduce(space.linear(less, pairs)))
    worth = [likelihood.evidence([k]) for k in range(len(tried))]
    if worth[0] < likelihood.evidence() + PLAIN:
        return fitted
    best: dict[str, int] = {}
    for k in np.argsort(worth)[::-1].tolist():
        if k and worth[k] > worth[0] - ABOUT_AS_GOOD:
            best.setdefault(names[k], k)
    scales = likelihood.best_scales([0])
    sized = [
        tried[k].with_values(**{n: tried[k][n] * _size(likelihood.reduced, k, scales)
                                for n in stage.sized})
        for k in list(best.values())[:SHAPES]
    ]  # fmt: skip
    found = abreast(space, [partial(_begun, space, fitted, s) for s in sized], fitted.parts)
    there = max((f for f in found if f is not None), key=lambda f: f.evidence, default=fitted)
    return there if there.evidence > fitted.evidence + FADES else fitted


def _size(reduced: Reduced, k: int, scales: tuple[float, float]) -> float:
    """How many times a trial the data ask for, at least a little of it."""
    t = reduced.trials[:, k]
    solved = np.linalg.solve(covariance_of(reduced, scales), np.column_stack([t, reduced.z]))
    along, z = t @ solved
    return max(float(z / along), 0.1)


def _begun(space: Space, fitted: Fitted, stage: Stage) -> Fitted | None:
    """Refitted from a shape; None where it cannot be played."""
    point = replace(fitted.point, model=fitted.point.model.with_stage(stage))
    try:
        return summit(space, refit_either_way(space, point), stage.id)
    except (InputError, np.linalg.LinAlgError):
        return None
