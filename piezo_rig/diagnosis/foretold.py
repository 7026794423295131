"""A law that is taken in for what it predicts, where none is likely enough to be.

As long as a model is far off, the evidence of its extensions is of what the base may be wrong by.
A law that is not quite the actuator's own fits least badly in a form that is nothing like it. What
says more then is how much less is left of recordings that no fit has seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from piezo_rig.diagnosis.forms import elsewhere, worth_of
from piezo_rig.diagnosis.ladder import Step
from piezo_rig.diagnosis.needed import worth_needed
from piezo_rig.diagnosis.refit import Fitted
from piezo_rig.diagnosis.refusals import FAR_OFF, of_a_law, worse
from piezo_rig.diagnosis.scan import Found, Scan

if TYPE_CHECKING:
    from piezo_rig.diagnosis.climb import Search

HALF = 0.5  # squared error beyond the noise, of that before
NEAR = 1.1  # held-out error of a rival, of the best one's
NEARER = 0.9  # held-out error, of that when forms were looked at, below which they are again


def foretold(
    search: Search, here: Fitted, found: Found, tried: Sequence[tuple[float, int, Fitted]],
    family: NDArray[np.float64],
) -> bool:
    """Take in the law, of those that were tried, that predicts best in whichever form.

    It must explain half of what is amiss, and predict better beyond doubt.
    """
    if search.aside or not _far_off(search, here, here):
        return False
    amiss = _amiss(search, here)
    best = {
        i: other for _, i, fitted in tried
        if (other := _likely(search, here, found.result, i, fitted)) is not None
    }  # fmt: skip
    order = sorted(best, key=lambda i: search.error(0, best[i]))
    for i in order:
        id, fitted = found.result.ids[i], best[i]
        if _amiss(search, fitted) > HALF * amiss:
            return False
        if of_a_law(search, fitted, id, here) or not search.helps(here, fitted, False):
            continue
        least = NEAR * search.error(0, fitted)
        near = [j for j in order if j != i and search.error(0, best[j]) < least]
        search.barred.pop(id, None)
        rivals = {found.result.ids[j]: float(found.result.ratio[j]) for j in near}
        search.accept(Step(id, float(family[i]), fitted, rivals))
        search.tidy()
        return True
    return False


def in_a_better_form(
    search: Search, here: Fitted, result: Scan, i: int, fitted: Fitted
) -> Fitted:
    """A law that is taken in, in a form that leaves half of what this one leaves, if one does."""
    if search.aside or not _far_off(search, here, fitted):
        return fitted
    other = _likely(search, here, result, i, fitted)
    if other is None or _amiss(search, other) > HALF * _amiss(search, fitted):
        return fitted
    return other if search.helps(fitted, other, False) else fitted


def _far_off(search: Search, here: Fitted, fitted: Fitted) -> bool:
    """Whether a model that follows the data is far off all the same."""
    return not here.point.fixed and search.error(0, fitted) > FAR_OFF * search.noise_nm


def _likely(
    search: Search, here: Fitted, result: Scan, i: int, fitted: Fitted
) -> Fitted | None:
    """A law in the form that predicts best, of those that are likely and predict no worse.

    Not looked for again until the model has come nearer.
    """
    id, best, error = result.ids[i], None, search.error(0, here)
    if error > NEARER * search.looked_at.get(id, np.inf):
        return None
    search.looked_at[id] = error
    for other in elsewhere(search.space, fitted, id, here):
        chance = 2.0 * result.null_median[i] + worth_needed(other, id)
        if worth_of(other, id) - here.evidence < chance:
            continue
        if best is not None and search.error(0, best) < search.error(0, other):
            continue
        if worse(search, other, here) is None:
            best = other
    return best


def _amiss(search: Search, fitted: Fitted) -> float:
    """Squared held-out error beyond the noise, nm^2."""
    return max(search.error(0, fitted) ** 2 - search.noise_nm**2, 0.0)
