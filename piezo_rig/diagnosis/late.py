"""A delay for a lag, and a lag for a delay, once more is known.

Which of the two there is shows at corners alone. A linear look names one of them while something
is still missing that corners show as well. So the other is put in its place whenever a member has
been found beside it, and stays where it says plainly more; at the end it is an alternative where
it says as much.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.forms import as_late
from piezo_rig.diagnosis.refit import Fitted, refit
from piezo_rig.diagnosis.refusals import worse
from piezo_rig.diagnosis.scan import candidates
from piezo_rig.errors import InputError

if TYPE_CHECKING:
    from piezo_rig.diagnosis.climb import Search

PLAINLY = 3.0  # log-likelihood by which the other must say more

def rather_the_other(search: Search) -> None:
    """Put a delay in a lag's place, or a lag in a delay's, where that says plainly more."""
    for k, id, there in _the_others(search):
        if there.evidence < search.fitted.evidence + PLAINLY:
            continue
        if worse(search, there, search.fitted) is not None:
            continue
        steps = [*search.steps]
        steps[k] = replace(steps[k], cause=id, rivals={})
        steps[-1] = replace(steps[-1], fitted=there)
        search.steps, search.rearranged = steps, True
        search.barred.pop(id, None)
        return


def note_the_other(search: Search) -> None:
    """Note a lag or a delay that may as well stand in the place of the other."""
    for k, id, there in _the_others(search):
        step = search.steps[k]
        if id not in step.rivals and search.as_good(there, search.fitted, id):
            gained = there.evidence - search.fitted.evidence
            search.steps[k] = replace(step, rivals={**step.rivals, id: gained})


def _the_others(search: Search) -> Iterator[tuple[int, str, Fitted]]:
    """Steps by number, what may stand in the place of each, and the refit with that."""
    members = search.causes
    for k, step in enumerate(search.steps):
        own = CAUSES.get(step.cause)
        if own is None or not (issubclass(own, Cause) and own.lasting):
            continue
        offered, _ = candidates(search.space, search.fitted.point.model.without(step.cause))
        for c in offered:
            kind = CAUSES[c.id]
            assert issubclass(kind, Cause)
            if not kind.lasting or c.id in members:
                continue
            search.tell(f"refit with {c.id} for {step.cause}")
            there = _instead(search, own, kind)
            if there is not None:
                yield k, c.id, there


def _instead(search: Search, own: type[Cause], other: type[Cause]) -> Fitted | None:
    """Refitted with another cause that is as late; None where it cannot be played."""
    point = search.fitted.point
    stage = point.model.stage(own.id)
    assert stage is not None
    seconds = float(np.clip(stage[own.lasting], *other.limits[other.lasting]))
    model = point.model.without(own.id).with_stage(other.of(None, **{other.lasting: seconds}))
    sizes = tuple(
        (other.id, other.lasting, size) if (id, name) == (own.id, own.lasting) else (id, name, size)
        for id, name, size in point.sizes
        if id != own.id or name == own.lasting
    )
    try:
        return as_late(
            search.space, refit(search.space, Point(model, point.fixed, sizes), held=True), other.id
        )
    except (InputError, np.linalg.LinAlgError):
        return None
