"""A memoryless bend, of the base that all causes are compared with."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes import CAUSES, STAGES
from piezo_rig.chain.bend import Bend
from piezo_rig.chain.model_file import bent_model
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.forms import converged
from piezo_rig.diagnosis.held import own_um_of
from piezo_rig.diagnosis.ladder import Step
from piezo_rig.diagnosis.put_in import refitted
from piezo_rig.diagnosis.refit import Fitted, refit
from piezo_rig.diagnosis.refusals import worse
from piezo_rig.diagnosis.scan import LEVEL, Found, score_powers

if TYPE_CHECKING:
    from piezo_rig.diagnosis.climb import Search

BEND = Bend.id
FAR_OFF, MUCH = 2.0, 0.7  # so many times the noise; held-out error with a bend, of that before
NEARER = 0.9  # of that error, below which it is tried again
LARGE = 300.0  # log-likelihood of a cause that is refitted beside the bend


def bend(search: Search, here: Fitted, found: Found, good: NDArray[np.int64]) -> bool:
    """Take a memoryless bend into the base where it says more than any cause does, or where
    without it the model is far off.
    """
    model = here.point.model
    if model.stage(BEND) is not None or (here.point.fixed and search.space.loose):
        return False
    best = float(found.result.ratio[good].max()) if good.size else 0.0
    far = _far_off(search, here)
    ratio, p = score_powers(found.linear, search.rng, 0.0 if far else best)
    if p > LEVEL or (ratio <= best and not far):
        return False
    if here.point.fixed:  # it does not say what its bend is: it is allowed to be wrong by any
        search.tell("baseline, allowed a bend")
        search.space.loose = True
        search.first, search.steps = refit(search.space, search.first.point), []
        return True
    search.tell("bend")
    scales = search.space.scales
    bent = model.with_stage(Bend.none(scales.low_v, scales.span_v))
    fitted = refit(search.space, Point(bent, (), here.point.sizes), held=True)
    fitted = converged(search.space, fitted)  # what made up for the bend has to move
    # of one loop alone bend and tables are hardly told apart: cycles that are left out refuse it
    if worse(search, fitted, here, ways=1) is not None:
        return False
    if ratio <= best and search.error(0, fitted) > MUCH * search.error(0, here):
        search.refused_at[BEND] = NEARER * search.error(0, here)
        return False
    for i in good[np.argsort(-found.result.ratio[good])]:  # the likeliest first
        kind = CAUSES[found.result.ids[i]]
        if getattr(kind, "cuts_off", False) and found.result.ratio[i] > LARGE:
            search.tell(f"refit with {found.result.ids[i]}")
            rival = refitted(search.space, here, found, int(i))
            if rival is None:
                search.came_to_nothing(found.result.ids[i], here)
            elif rival.evidence > fitted.evidence:
                search.rather = [int(i)]  # whatever a linear look makes of it
                return False
    search.accept(Step(BEND, p, fitted))
    return True


def _far_off(search: Search, here: Fitted) -> bool:
    """Whether so much is left that a bend may hide what causes do to what was held out.

    Whatever bends go by is projected off before causes are scored: they say little of it.
    """
    error = search.error(0, here)
    near = search.refused_at.get(BEND, np.inf)
    return not here.point.fixed and FAR_OFF * search.noise_nm < error < near


def with_own_bend(search: Search) -> None:
    """Take a given model with the bend that was seen where it was identified.

    Beside an effect many times larger it may be further off than without, by chance; not by more
    than the model without it was off by itself.
    """
    bent = bent_model(search.first.point.model, STAGES) if search.first.point.fixed else None
    if bent is None:
        return
    search.tell("baseline, with its bend")
    _, p = score_powers(search.space.linear(search.first.point), search.rng)
    own_um, search.space.own_um = search.space.own_um, own_um_of(bent, search.space.groups)
    fitted = refit(search.space, Point(bent, tuple(s.id for s in bent.stages)))
    if search.error(0, fitted) < search.error(0, search.first) + 1e3 * own_um:
        search.accept(Step(BEND, p, fitted))
    else:
        search.space.own_um = own_um
