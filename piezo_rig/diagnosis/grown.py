"""A refitted cause at its best reach, and what it is worth then."""

from __future__ import annotations

from typing import TYPE_CHECKING

from piezo_rig.causes import CAUSES
from piezo_rig.causes.first_spring import FirstSpring
from piezo_rig.diagnosis.forms import CARRIES, carries, reached
from piezo_rig.diagnosis.held_springs import with_force_kept
from piezo_rig.diagnosis.needed import worth_needed
from piezo_rig.diagnosis.put_in import LARGE
from piezo_rig.diagnosis.refit import Fitted, gained
from piezo_rig.diagnosis.scan import Found

if TYPE_CHECKING:
    from piezo_rig.diagnosis.climb import Search

FAR_BEHIND = 0.5  # of the best refit's gain: below it a rival's reach is not looked for
Tried = tuple[float, int, Fitted]  # what a cause is worth once refitted, its number, the refit


def grown(
    search: Search, here: Fitted, found: Found, i: int, fitted: Fitted, most: float
) -> tuple[float, Fitted, float | None]:
    """A refit at its best reach; what it is worth, and its held-out error if that matters.

    Parameters
    ----------
    here : without it
    i : its number in the scan
    most : what the best of its rivals gains, log-likelihood
    """
    id = found.result.ids[i]
    # a law that is steep may be far behind until it is begun so
    steep = most < LARGE and issubclass(CAUSES[id], FirstSpring)
    if steep or gained(fitted, here) >= FAR_BEHIND * most:
        fitted = reached(search.space, fitted, id, here)
        fitted = with_force_kept(search.space, fitted, id, here)
    chance = 2.0 * found.result.null_median[i] + worth_needed(fitted, id)
    chance += CARRIES * carries(fitted, id)
    worth = float(gained(fitted, here) - chance)
    return worth, fitted, search.error(0, fitted) if worth > 0.0 else None
