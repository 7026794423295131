"""A cause put into a model: from what a linear look made of it to the best refit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.forms import as_late, begun_best, beside_kinks, further, in_another_form
from piezo_rig.diagnosis.needed import does_nothing, needless, plain_bend
from piezo_rig.diagnosis.refit import Fitted, refit, refit_either_way, settle
from piezo_rig.diagnosis.scan import Found, extended
from piezo_rig.diagnosis.space import Space
from piezo_rig.errors import InputError

LARGE = 300.0  # log-likelihood above which the linear start is not trusted
LOST = 0.3  # of what a linear look at a cause promised; a refit that keeps less went too far


def descended(space: Space, point: Point, here: Fitted, promised: float) -> Fitted:
    """Refitted; by one step only where more of them lose most of what was promised.

    A level that is stepped over leaves nothing to step back by.
    """
    fitted = refit_either_way(space, point)
    if fitted.evidence - here.evidence >= LOST * promised:
        return fitted
    near = refit(space, point, steps=1, held=True)
    there = refit(space, near.point, steps=0, held=True)  # by the tangent there
    near = replace(near, evidence=there.evidence)
    return max(fitted, near, key=lambda f: f.evidence)


def refitted(space: Space, here: Fitted, found: Found, i: int) -> Fitted | None:
    """The model with a cause put in; None where that comes to nothing."""
    candidate = found.candidates[i]
    columns, form = found.chosen[candidate.id]
    try:
        settle(space, here.point)
        point = extended(space, here, candidate, columns, found.likelihood, form)
        promised = found.likelihood.evidence(columns) - found.likelihood.evidence()
        point = begun_best(space, point, candidate.id, form[0], promised)
        fitted = descended(space, point, here, promised)
        if fitted.evidence > here.evidence + LARGE:
            fitted = further(space, fitted, candidate.id)
        fitted = beside_kinks(space, fitted, candidate.id)
        fitted = as_late(space, fitted, candidate.id)
        fitted = in_another_form(space, fitted, candidate.id)
    except (InputError, np.linalg.LinAlgError):
        fitted = None  # at the size that the data ask for it cannot even be played
    if fitted is None or does_nothing(space, fitted.point, candidate.id):
        return None
    plain = plain_bend(candidate.id, fitted, here)
    if not plain and needless(fitted, [candidate.id]) is not None:
        return None
    return fitted
