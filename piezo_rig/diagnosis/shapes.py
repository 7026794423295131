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
from piezo_rig.diagnosis.forms import summit
from piezo_rig.diagnosis.likelihood import Likelihood
from piezo_rig.diagnosis.needed import at_a_limit
from piezo_rig.diagnosis.reduction import Reduced, covariance_of, reduce
from piezo_rig.diagnosis.refit import Fitted, playable, refit_either_way, settle
from piezo_rig.diagnosis.space import Space
from piezo_rig.errors import InputError

PLAIN = 20.0  # log-likelihood of a cause whose shape may show
ABOUT_AS_GOOD, COARSE = 5.0, 0.2  # by which a look may be worse; of what it says, as it is coarse
PLAINLY = 12.0  # log-likelihood by which another shape must be better
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
    limited = at_a_limit(fitted.point, id)  # then it is not this law
    most = max(worth[1:] if limited else worth)
    gained = most - likelihood.evidence()
    if gained < PLAIN:
        return fitted
    best: dict[str, int] = {}
    for k in np.argsort(worth)[::-1].tolist():
        if k and worth[k] > most - max(ABOUT_AS_GOOD, COARSE * gained):
            best.setdefault(names[k], k)
    scales = likelihood.best_scales([int(np.argmax(worth))])
    sized = [
        tried[k].with_values(**{n: tried[k][n] * _size(likelihood.reduced, k, scales)
                                for n in stage.sized})
        for k in list(best.values())[:SHAPES]
    ]  # fmt: skip
    found = abreast(space, [partial(_begun, space, fitted, s) for s in sized], fitted.parts)
    here = fitted.evidence
    if limited:
        found = [f for f in found if f is not None and not at_a_limit(f.point, id)]
        here = likelihood.evidence()
    there = max((f for f in found if f is not None), key=lambda f: f.evidence, default=fitted)
    return there if there.evidence > here + PLAINLY else fitted


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
        found = refit_either_way(space, point)
        scanned = isinstance(stage, Cause) and stage.scanned[0] in stage.parameters
        return summit(space, found, stage.id) if scanned else found
    except (InputError, np.linalg.LinAlgError):
        return None
