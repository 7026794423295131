"""Whether a member of a model says anything, by its own numbers."""

from __future__ import annotations

import numpy as np

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.diagnosis.chances import chi2_at
from piezo_rig.diagnosis.context import context_of
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.refit import Fitted, changed_um, playable, square_of
from piezo_rig.diagnosis.scan import of_base
from piezo_rig.diagnosis.space import Space

CHANCE = 0.3  # log-likelihood that every element of a table gains
SEEN = 2.0  # d' in white noise, with nothing else to explain it, below which nothing is seen
OWN = 0.1  # of what a given model was off by itself, noise and all: no more is no news
PLAIN = 50.0  # log-likelihood that a bend is worth, however uncertain its size
MUCH = 1.1  # squared error, of that with the bend
BEYOND = 2.0  # times the least that a drive monitor would have shown, which it cannot have missed
DIFFERENT = 1e-4  # a member must differ from nothing at this level


def plain_bend(id: str, fitted: Fitted, less: Fitted) -> bool:
    """Whether it is a bend without which plainly less is said, or plainly more is left.

    Bends of several kinds do much the same: what one adds may be plain, though not how much of
    each there is. What all of them do is projected off before evidence is looked at.
    """
    if not of_base(id):
        return False
    plain = fitted.evidence > less.evidence + PLAIN
    return plain or square_of(less.linear) > MUCH * square_of(fitted.linear)


def worth_needed(fitted: Fitted, id: str) -> float:
    """Log-likelihood that a table of its own must be worth: about what chance gives it.

    Without anything to find, 24 recordings of the independent bench gave 15 to 32 to 80 elements.
    """
    stage = fitted.point.model.stage(id)
    assert stage is not None
    return CHANCE * len(stage.elements) if stage.elements is not None else 0.0


def needless(fitted: Fitted, causes: list[str]) -> str | None:
    """A member whose parameters are not different from doing nothing.

    Its optional ones are held: how far a law reaches means nothing where there is no law, and data
    that leave the two open together may still show plainly that there is one.
    """
    values = fitted.point.values()[fitted.point.linear :]
    for cause in causes:
        kind = CAUSES[cause]
        own = [
            j for j, (id, name) in enumerate(fitted.point.names)
            if id == cause and name not in getattr(kind, "priors", {})
        ]
        optional = getattr(kind, "optional", {})
        index = [j for j in own if fitted.point.names[j][1] not in optional]
        rest = [j for j in own if j not in index]
        if not index:
            continue
        off = values[index] - [kind.neutral.get(fitted.point.names[j][1], 0.0) for j in index]
        covariance = fitted.covariance[np.ix_(index, index)]
        if rest:
            cross = fitted.covariance[np.ix_(index, rest)]
            of_rest = fitted.covariance[np.ix_(rest, rest)]
            covariance = covariance - cross @ np.linalg.pinv(of_rest, hermitian=True) @ cross.T
        distance = float(off @ np.linalg.solve(covariance, off))
        if distance < chi2_at(DIFFERENT, len(index)):
            return cause
    return None


def at_a_limit(point: Point, id: str, but: str = "") -> bool:
    """Whether a fitted number of a member is at a limit: a law that runs into one is not this law.

    ``but`` : a number that is not asked for
    """
    stage = point.model.stage(id)
    assert stage is not None
    limits = getattr(type(stage), "limits", {})
    own = [n for i, n in point.names if i == id and n != but]
    return any(not limits[n][0] < stage[n] < limits[n][1] for n in own if n in limits)


def too_long(space: Space, point: Point, id: str) -> bool:
    """Whether a member lasts longer than a drive monitor leaves room for, which shows none."""
    if id not in space.longest:
        return False
    stage = point.model.stage(id)
    return isinstance(stage, Cause) and stage[stage.lasting] > BEYOND * space.longest[id]


def does_nothing(space: Space, point: Point, id: str) -> bool:
    """Whether a member came out at a limit, or changes less than the noise of all data shows."""
    stage = point.model.stage(id)
    assert stage is not None
    names = [n for i, n in point.names if i == id]
    if not names:
        return False
    if at_a_limit(point, id):
        return True
    if isinstance(stage, Cause) and not stage.plausible(context_of(space, point.model)):
        return True
    less = point.model.without(id)
    if not playable(space, less):  # the tables alone are no actuator: the member does much
        return False
    samples = sum(g.repeats * (b - a) for g in space.groups.groups for a, b in g.blocks)
    change = 1e3 * changed_um(space, less, point.model)
    if np.isfinite(space.own_um) and change < OWN * 1e3 * space.own_um:
        return True
    return bool(change * np.sqrt(samples / space.groups.factor) < SEEN * space.noise_nm)
