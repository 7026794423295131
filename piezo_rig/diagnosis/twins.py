"""Laws that do nearly the same in the data at hand, though they are of different things.

Where all triangles have one frequency half loops that go further are as much faster: a law of the
range and one of the speed differ by how they begin after a turn and by their curve, of which the
forms that are known here need not be the actuator's. A law of the extremum whose spring keeps its
force is one of the range over loops that begin at one voltage. A linear look may make little of
either beside the other. Where all loops are equal a law of the range shows in the first rise alone,
which a table of its own follows whatever it does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.causes.first_spring import FirstSpring
from piezo_rig.diagnosis.context import at_one_frequency, at_one_range
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.forms import carries
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.grown import Tried
from piezo_rig.diagnosis.put_in import all_free
from piezo_rig.diagnosis.refit import Fitted, refit
from piezo_rig.diagnosis.scan import Scan, candidates, like_range, like_speed
from piezo_rig.errors import InputError

if TYPE_CHECKING:
    from piezo_rig.diagnosis.climb import Search

# descents of least squares; held-out error after one, of that before, that asks for another
DESCENTS, STILL = 8, 0.9995


def twins_of(search: Search, result: Scan, fits: Sequence[Tried]) -> list[int]:
    """Numbers of what may do the same as something that was refitted, and was not refitted."""
    said = {result.ids[i]: fitted for worth, i, fitted in fits if worth > 0.0}
    springs = [id for id in result.ids if issubclass(CAUSES[id], FirstSpring)]
    wanted = springs if any(carries(said[id], id) for id in springs if id in said) else []
    if any(map(like_speed, said)) and at_one_frequency(search.space.groups):
        wanted = [*wanted, *filter(like_range, result.ids)]
    tried = {result.ids[i] for _, i, _ in fits} | search.barred.keys()
    return [i for i, id in enumerate(result.ids) if id in wanted and id not in tried]


def are_twins(groups: Groups, id: str, other: str) -> bool:
    """Whether one goes by the range and the other by the speed, of loops of one frequency; or by
    the range and by first rises alone, of equal loops.
    """
    for one, twin in ((id, other), (other, id)):
        if like_speed(one) and like_range(twin) and at_one_frequency(groups):
            return True
        if like_speed(one) and CAUSES[twin].has_elements and at_one_range(groups):
            return True
    return False


def foretelling_as_well(
    search: Search, here: Fitted, fitted: Fitted, id: str, refits: Mapping[str, Fitted],
    least: float,
) -> list[str]:  # fmt: skip
    """Of a law and its twin the other, if it predicts what is held out as well; were it only where
    plain least squares ends, but for a table, which follows whatever it is fitted to.

    Next to what elements may make up for, their evidence is of how well each has the form.

    Parameters
    ----------
    here : the model without any
    fitted, id : the model that was taken, and the cause that it was taken for
    refits : with other causes
    least : held-out error of another, of that of the model
    """
    space, found = search.space, list[str]()
    if not any(are_twins(space.groups, id, other) for other in CAUSES):
        return found
    most = least * search.error(0, fitted)
    for candidate in candidates(space, here.point.model)[0]:
        other = candidate.id
        if not are_twins(space.groups, id, other):
            continue
        if other in refits and search.error(0, refits[other]) <= most:
            found.append(other)
            continue
        if CAUSES[id].has_elements or CAUSES[other].has_elements:
            continue
        known = refits[other].point.model.stage(other) if other in refits else None
        usual = known or candidate.variants[0][0]
        assert isinstance(usual, Cause)
        for stage in (usual, usual.usual()):
            model = here.point.model.with_stage(stage)
            point = all_free(replace(here.point, model=model), stage)
            if _reaches(search, point, most):
                found.append(other)
                break
    return found


def _reaches(search: Search, point: Point, most: float) -> bool:
    """Whether plain least squares, the optional numbers free as well, gets to a held-out error.

    What a lag and elements can do for each other it finds out slowly.
    """
    before = np.inf
    for _ in range(DESCENTS):
        try:
            fitted = refit(search.space, point, plain=True)
        except (InputError, np.linalg.LinAlgError):
            return False
        error, point = search.error(0, fitted), fitted.point
        if error <= most:
            return True
        if error > STILL * before:
            return False
        before = error
    return False
