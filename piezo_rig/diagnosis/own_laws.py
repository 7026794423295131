"""Members of a ladder of which the data know more than the law that is assumed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.diagnosis.context import context_of
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.forms import summit
from piezo_rig.diagnosis.likelihood import Likelihood
from piezo_rig.diagnosis.put_in import all_free, descended
from piezo_rig.diagnosis.reduction import reduce
from piezo_rig.diagnosis.refit import Fitted, settle, wholly
from piezo_rig.diagnosis.refusals import worse
from piezo_rig.diagnosis.spare import prune, stood_in

if TYPE_CHECKING:
    from piezo_rig.diagnosis.climb import Search

LOOSE = 15.0  # log-likelihood that a law must gain by being let go of
MORE = 8.0  # the same of a member that does one thing more
AS_MUCH = 5.0  # log-likelihood, by which that may say less than another cause
PROMISED = 0.5  # of that, by a linear look at what is then free, for a refit to be tried


def loosen(search: Search, here: Fitted, best: float) -> bool:
    """Let go of the assumed law of a member where that gains more than ``best``."""
    for id in search.causes:
        kind, stage = CAUSES[id], here.point.model.stage(id)
        free = kind.loosened if issubclass(kind, Cause) else {}
        if stage is None or not free or set(free) <= set(stage.parameters):
            continue
        wide = stage.with_values(**{n: stage.neutral[n] for n in free})
        sizes = (*here.point.sizes, *((id, n, size) for n, size in free.items()))
        point = replace(here.point, model=here.point.model.with_stage(wide), sizes=sizes)
        if promised(search, here, point) < PROMISED * max(LOOSE, best):
            continue
        search.tell(f"refit with {id} of its own law")
        fitted = wholly(search.space, point)
        gained = fitted.evidence - here.evidence
        if gained > max(LOOSE, best) and worse(search, fitted, here) is None:
            search.steps[-1] = replace(search.steps[-1], fitted=fitted)
            search.rearranged = True  # the gain is that of the member, not of the latest rung
            stood_in(search, id)
            return True
    return False


def rather(search: Search, here: Fitted, fitted: Fitted, id: str) -> bool:
    """Let go of the assumed law of a member instead of taking in what acts as fast as that may
    begin, where that says about as much.
    """
    new = fitted.point.model.stage(id)
    groups = search.space.groups
    if not isinstance(new, Cause) or new.late_s(groups.travel_um / groups.span_v) == np.inf:
        return False
    members = [here.point.model.stage(c) for c in search.causes]
    if not any(isinstance(s, Cause) and s.as_late_s > 0.0 for s in members):
        return False
    return loosen(search, here, fitted.evidence - here.evidence - AS_MUCH)


def also(
    search: Search, here: Fitted, best: float, rival: Callable[[], float] = lambda: 0.0
) -> bool:
    """Let a member do besides what it does not do yet, where that gains more than ``best``, and
    more than a ``rival`` is worth once that is refitted.
    """
    model = here.point.model
    context = context_of(search.space, model)
    for id in search.causes:
        stage = model.stage(id)
        if not isinstance(stage, Cause) or not (forms := stage.also(context)):
            continue
        settle(search.space, here.point)
        pairs = [(model, model.with_stage(form)) for form in forms]
        likelihood = Likelihood(reduce(search.space.linear(here.point, pairs)))
        looks = [likelihood.evidence([k]) - likelihood.evidence() for k in range(len(forms))]
        form, most = forms[int(np.argmax(looks))], max(looks)
        if most < PROMISED * max(MORE, best):
            continue
        search.tell(f"refit with more of {id}")
        point = Point(model.with_stage(form), here.point.fixed, here.point.sizes)
        fitted = descended(search.space, all_free(point, form), here, most)
        if stage.scanned[0] in set(form.parameters) - set(stage.parameters):
            fitted = summit(search.space, fitted, id)
        gained = fitted.evidence - here.evidence
        if gained > max(MORE, best) and worse(search, fitted, here) is None and gained > rival():
            search.steps[-1] = replace(search.steps[-1], fitted=fitted)
            search.rearranged = True
            prune(search)
            return True
    return False


def promised(search: Search, here: Fitted, point: Point) -> float:
    """What a linear look says that freeing more parameters gains."""
    n, q = here.point.linear, len(here.point.sizes)
    settle(search.space, here.point)
    linear = search.space.linear(point)
    likelihood = Likelihood(reduce(linear, free=range(n, n + len(point.sizes))))
    columns = range(-len(point.sizes), 0)
    return likelihood.evidence(columns) - likelihood.evidence(columns[:q])
