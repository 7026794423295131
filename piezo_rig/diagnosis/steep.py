"""A first spring that follows range or extremum, begun at its size.

Half loops that go further are faster, open further, and end where a bend would bring them. What a
large spring does on the average the elements have gone after; of what is left a linear look makes
little, or a bend of the base, or what goes by speed, and no descent leads there from a small slope.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from piezo_rig.causes import CAUSES
from piezo_rig.causes.first_spring import FirstSpring
from piezo_rig.diagnosis.abreast import abreast
from piezo_rig.diagnosis.first_spring import without_offset
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.grown import Tried, grown
from piezo_rig.diagnosis.needed import at_a_limit
from piezo_rig.diagnosis.put_in import all_free
from piezo_rig.diagnosis.refit import Fitted, refit
from piezo_rig.diagnosis.scan import Found, by_speed, like_speed
from piezo_rig.diagnosis.space import Space
from piezo_rig.diagnosis.spare import AMISS
from piezo_rig.errors import InputError

if TYPE_CHECKING:
    from piezo_rig.diagnosis.climb import Search

STEEP = "steep "  # and a cause: the held-out error at which it was begun so
NEARER = 0.9  # of that, from which on it is begun once more
MUCH = 0.3  # squared error beyond the noise, of that before, that others leave and it may explain
AS_MUCH = 10.0  # log-likelihood that a law's constant part of its own is worth


def begun_steep(
    search: Search, here: Fitted, found: Found, fits: Sequence[Tried]
) -> list[Tried]:
    """First springs that follow a law from their size, where something goes by speed or the best of
    what was refitted leaves something amiss; without those that are worth nothing, or that say
    less than they did from a small slope.

    Parameters
    ----------
    here : the model without them
    fits : what was refitted so far
    """
    ids, so_far = found.result.ids, {i: fitted for _, i, fitted in fits}
    if here.point.fixed:
        return []
    out: list[Tried] = []
    for i, id in enumerate(ids):
        kind = CAUSES[id]
        if not issubclass(kind, FirstSpring) or not _asked_for(search, here, ids, i, fits):
            continue
        search.tell(f"refit with {id}, begun steep")
        search.patience.spend(1)
        best = _best(search.space, here, kind)
        if best is None or best.evidence <= so_far.get(i, here).evidence:
            continue
        most = max((f.evidence for f in so_far.values()), default=here.evidence) - here.evidence
        worth, fitted, error = grown(search, here, found, i, best, most)
        if worth <= 0.0 or at_a_limit(fitted.point, id, kind.scanned[0]):
            continue
        out.append((worth, i, fitted))
        if error is not None:
            search.keep_error(fitted, error)
    return out


def _asked_for(
    search: Search, here: Fitted, ids: Sequence[str], own: int, fits: Sequence[Tried]
) -> bool:
    """Whether a spring may be what others stand in for, and was not begun so as far off as this."""
    nearest = {i: search.error(0, f) for worth, i, f in fits if worth > 0.0 or i == own}
    error = search.error(0, here)
    before, left = (max(e**2 - search.noise_nm**2, 0.0)
                    for e in (error, min([error, *nearest.values()])))  # fmt: skip
    amiss = left > (AMISS * search.noise_nm) ** 2
    if not (amiss and (own in nearest or left > MUCH * before)):
        fast = like_speed(ids[own]) and any(
            by_speed(ids[i]) and e < nearest.get(own, np.inf) for i, e in nearest.items()
        )
        if not fast:
            return False
    if error > NEARER * search.looked_at.get(STEEP + ids[own], np.inf):
        return False
    search.looked_at[STEEP + ids[own]] = error
    return True


def _best(space: Space, here: Fitted, kind: type[FirstSpring]) -> Fitted | None:
    """The likeliest end of all its begins."""
    followed = np.concatenate([kind.history(g.loops) for g in space.groups.groups])
    mean_v = float(followed.mean()) if followed.size else 0.0
    points = [
        all_free(replace(here.point, model=here.point.model.with_stage(stage)), stage)
        for stage in kind.at_its_size(space.groups.travel_um, mean_v)
    ]
    ends = abreast(
        space, [partial(_from_least_squares, space, p, kind.id) for p in points], here.parts
    )
    return max((f for f in ends if f is not None), key=lambda f: f.evidence, default=None)


def _from_least_squares(space: Space, point: Point, id: str) -> Fitted | None:
    """Refitted from where plain least squares ends, or that place where it is likelier: what else
    may be amiss takes in a part of a large effect, and holds it back.

    The law's constant part is the table's again where that says as much, as in all other fits.
    """
    try:
        plain = refit(space, point, held=True, plain=True)
        there = max(plain, refit(space, plain.point, held=True), key=lambda f: f.evidence)
    except (InputError, np.linalg.LinAlgError):
        return None
    try:
        tabled = refit(space, _tabled(there.point, id), held=True)
    except (InputError, np.linalg.LinAlgError):
        return there  # the table cannot take it
    return tabled if tabled.evidence > there.evidence - AS_MUCH else there


def _tabled(point: Point, id: str) -> Point:
    """The constant part of a law moved into the table, and no longer free."""
    law, table = point.model.stage(id), point.model.maxwell.elements
    assert isinstance(law, FirstSpring)
    assert table is not None
    moved = point.model.maxwell.of(without_offset(table, law, -law["offset"]))
    stages = {"maxwell": moved, id: law.with_values(offset=0.0)}
    model = point.model.with_(stages=tuple(stages.get(s.id, s) for s in point.model.stages))
    sizes = tuple(s for s in point.sizes if s[:2] != (id, "offset"))
    return replace(point, model=model, sizes=sizes)
