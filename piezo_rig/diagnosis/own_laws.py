"""Members of a ladder of which the data know more than the law that is assumed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.likelihood import Likelihood
from piezo_rig.diagnosis.reduction import reduce
from piezo_rig.diagnosis.refit import Fitted, settle, wholly
from piezo_rig.diagnosis.spare import stood_in

if TYPE_CHECKING:
    from piezo_rig.diagnosis.climb import Search

LOOSE = 15.0  # log-likelihood that a law must gain by being let go of
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
        if gained > max(LOOSE, best) and search.worse(fitted, here) is None:
            search.steps[-1] = replace(search.steps[-1], fitted=fitted)
            search.rearranged = True  # the gain is that of the member, not of the latest rung
            stood_in(search, id)
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
