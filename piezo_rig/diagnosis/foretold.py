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
from piezo_rig.diagnosis.scan import Found

if TYPE_CHECKING:
    from piezo_rig.diagnosis.climb import Search

HALF = 0.5  # squared error beyond the noise, of that before
NEAR = 1.1  # held-out error of a rival, of the best one's


def foretold(
    search: Search, here: Fitted, found: Found, tried: Sequence[tuple[float, int, Fitted]],
    family: NDArray[np.float64],
) -> bool:
    """Take in the law, of those that were tried, that predicts best in whichever form.

    It must explain half of what is amiss, and predict better beyond doubt.
    """
    if here.point.fixed or search.error(0, here) < FAR_OFF * search.noise_nm or search.aside:
        return False
    result, amiss = found.result, _amiss(search, here)
    best: dict[int, Fitted] = {}
    for _, i, fitted in tried:
        id = result.ids[i]
        search.tell(f"refit with {id} in other forms")
        for other in elsewhere(search.space, fitted, id, here):
            chance = 2.0 * result.null_median[i] + worth_needed(other, id)
            if worth_of(other, id) - here.evidence < chance or (
                i in best and search.error(0, best[i]) < search.error(0, other)
            ):  # fmt: skip
                continue
            best[i] = other
    order = sorted(best, key=lambda i: search.error(0, best[i]))
    for i in order:
        id, fitted = result.ids[i], best[i]
        if _amiss(search, fitted) > HALF * amiss:
            return False
        if worse(search, fitted, here) or of_a_law(search, fitted, id):
            continue
        if not search.helps(here, fitted):
            continue
        least = NEAR * search.error(0, fitted)
        rivals = [result.ids[j] for j in order if j != i and search.error(0, best[j]) < least]
        search.barred.pop(id, None)
        search.accept(Step(id, float(family[i]), fitted, tuple(rivals)))
        search.tidy()
        return True
    return False


def _amiss(search: Search, fitted: Fitted) -> float:
    """Squared held-out error beyond the noise, nm^2."""
    return max(search.error(0, fitted) ** 2 - search.noise_nm**2, 0.0)
