"""What a linear look leaves in doubt, taken in where it explains much of what is amiss."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from piezo_rig.diagnosis.detours import ONE_MORE, beside
from piezo_rig.diagnosis.grown import Tried
from piezo_rig.diagnosis.ladder import Step
from piezo_rig.diagnosis.race import tried
from piezo_rig.diagnosis.refit import Fitted
from piezo_rig.diagnosis.refusals import beyond_noise, of_a_law, worse
from piezo_rig.diagnosis.scan import LEVEL, RUN_OFF, Found
from piezo_rig.diagnosis.spare import AMISS
from piezo_rig.diagnosis.steep import begun_steep

if TYPE_CHECKING:
    from piezo_rig.diagnosis.climb import Search

FloatArray = NDArray[np.float64]
# squared error beyond the noise, of that before, with what explains much of it, and some
MUCH_OF_IT, SOME_OF_IT = 0.7, 0.95


def explained(
    search: Search, here: Fitted, found: Found, family: FloatArray, of_the_rest: float
) -> bool:
    """Take in what explains much of what is amiss, although a look at it does not ask for it.

    Much of an effect looks like what the laws of others may be wrong by, and a large spring that
    follows the range like nothing that a small one does. What the next recording is predicted
    better by is neither. Where none explains much, the likeliest of those that explain some is
    taken with what then fits best: see `detours.beside`.

    Parameters
    ----------
    family : chances of a false alarm of what was looked at, shape (c,)
    of_the_rest : chance that nothing is left
    """
    if beyond_noise(search, here) < (AMISS * search.noise_nm) ** 2:
        return False
    if search.level < 1.0:
        return False
    good = np.flatnonzero(family < LEVEL)
    likeliest = good[np.argsort(-found.result.excess[good])][:RUN_OFF]
    fits = tried(search, here, found, likeliest)
    if _taken(search, here, found, fits, family):
        return True
    if of_the_rest >= LEVEL:
        return False
    steep = begun_steep(search, here, found, fits)
    if _taken(search, here, found, steep, np.minimum(family, of_the_rest)):
        return True
    amiss = beyond_noise(search, here)
    helping = [t for t in fits if t[0] > 0.0 and beyond_noise(search, t[2]) < SOME_OF_IT * amiss]
    if not helping or search.aside:
        return False
    _, i, fitted = max(helping, key=lambda t: t[0])
    return beside(search, here, Step(found.result.ids[i], float(family[i]), fitted))


def _taken(
    search: Search, here: Fitted, found: Found, fits: list[Tried], chance: FloatArray
) -> bool:
    """Take in the first of them, by what they are worth, that explains much and is no law's."""
    amiss = beyond_noise(search, here)
    for worth, i, fitted in sorted(fits, key=lambda t: -t[0]):
        id = found.result.ids[i]
        if worth > ONE_MORE and beyond_noise(search, fitted) < MUCH_OF_IT * amiss and (
            worse(search, fitted, here) is None and of_a_law(search, fitted, id, here) is None
        ):  # fmt: skip
            search.accept(Step(id, float(chance[i]), fitted))
            search.tidy()
            return True
    return False
