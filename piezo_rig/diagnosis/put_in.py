"""A cause put into a model: from what a linear look made of it to the best refit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from piezo_rig.causes.cause import Cause
from piezo_rig.chain import Stage
from piezo_rig.chain.bend import Bend
from piezo_rig.diagnosis.abreast import abreast
from piezo_rig.diagnosis.context import context_of
from piezo_rig.diagnosis.engine import plain_space
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.forms import (
    as_late,
    begun_best,
    beside_kinks,
    further,
    in_another_form,
    looked_at,
    walked,
)
from piezo_rig.diagnosis.needed import does_nothing, needless
from piezo_rig.diagnosis.refit import (
    Fitted,
    gained,
    refit,
    refit_either_way,
    settle,
    square_of,
)
from piezo_rig.diagnosis.scan import Form, Found, extended, of_base
from piezo_rig.diagnosis.shapes import in_another_shape
from piezo_rig.diagnosis.space import Space
from piezo_rig.errors import InputError

LARGE = 300.0  # log-likelihood above which the linear start is not trusted
LOOKED_AT = 2  # starts of an effect that goes by speed, from which plain least squares is tried
FAR_LESS = 0.5  # squared error, of that of the likeliest refit
LONG, NO_LESS, AS_NEAR = 12, 3.0, 1.1  # steps; log-likelihood; squared error, of that with both
FAR_OFF = 2.0  # times the noise, thinned as the recordings are
HALVED = 4  # times, of what is between two levels
TWICE, EVERY = 2, 3  # turns of a look at levels; every so many of them in the first
AS_MUCH = 3.0  # log-likelihood that a number more must promise for it not to be doubted
LOST = 0.3  # of what a linear look at a cause promised; a refit that keeps less went too far


def descended(space: Space, point: Point, here: Fitted, promised: float) -> Fitted:
    """Refitted; by one step only where more of them lose most of what was promised.

    A level that is stepped over leaves nothing to step back by.
    """
    fitted = refit_either_way(space, point)
    if gained(fitted, here) >= LOST * promised:
        return fitted
    near = refit(space, point, steps=1, held=True)
    there = refit(space, near.point, steps=0, held=True)  # by the tangent there
    near = replace(near, evidence=there.evidence)
    return max(fitted, near, key=lambda f: f.evidence)


def by_least_squares(space: Space, point: Point, fitted: Fitted, id: str) -> Fitted:
    """A cause that goes by speed where plain least squares ends, if that leaves far less.

    As long as other effects are missing, a large one is fitted to whatever of them looks like it:
    what leaves half of the squared error is nearer to it, whatever the evidence is.
    """
    stage = point.model.stage(id)
    if not isinstance(stage, Cause) or not stage.of_speed:
        return fitted
    starts = looked_at(space, point, stage.at_large(), LOOKED_AT)
    points = [replace(point, model=point.model.with_stage(s)) for s in starts]
    ends = abreast(space, [partial(_plainly, space, p) for p in points], fitted.parts)
    found = [f for f in ends if f is not None]
    best = min(found, key=lambda f: square_of(f.linear), default=fitted)
    return best if square_of(best.linear) < FAR_LESS * square_of(fitted.linear) else fitted


def _plainly(space: Space, point: Point) -> Fitted | None:
    try:
        return refit(space, point, held=True, plain=True)
    except (InputError, np.linalg.LinAlgError):
        return None


def instead_of_bend(space: Space, fitted: Fitted) -> Fitted:
    """A bend of another kind in place of the drive's, where both together say no more."""
    if fitted.point.model.stage(Bend.id) is None or fitted.point.fixed:
        return fitted
    less = refit(space, fitted.point.without(Bend.id), LONG, held=True)
    if less.evidence < fitted.evidence - NO_LESS:
        return fitted
    return less if square_of(less.linear) < AS_NEAR * square_of(fitted.linear) else fitted


def _from_either_end(space: Space, here: Fitted, found: Found, i: int, point: Point) -> Point:
    """Where to begin with a level that may be one from below or one from above.

    As long as a large one is missing, the base has gone after it at both ends of the drive: where
    it is, a linear look beside that base does not tell. With the base fitted anew it shows.
    """
    candidate = found.candidates[i]
    ends = found.at_either_end(candidate.id)
    if not ends:
        return point
    points = []
    for end in ends:
        columns, trials = max(end, key=lambda f: found.likelihood.evidence(f[0]))
        begun = extended(space, here, candidate, columns, found.likelihood, trials)
        points += [replace(begun, model=begun.model.with_stage(t)) for _, (t,) in end]
    return _nearest(space, here, points, candidate.id) or point


def _at_the_other_end(space: Space, here: Fitted, fitted: Fitted, id: str) -> Fitted:
    """A large level with one at the other end as well, where that says plainly more.

    Clipped at both ends a recording is predicted badly by a limit at either of them.
    """
    model = fitted.point.model
    stage = model.stage(id)
    if not isinstance(stage, Cause) or not stage.sharp:
        return fitted
    forms = stage.also(context_of(space, model))
    points = [all_free(replace(fitted.point, model=model.with_stage(f)), f) for f in forms]
    begun = _nearest(space, fitted, points, id)
    if begun is None:
        return fitted
    both = descended(space, begun, here, fitted.evidence - here.evidence)
    return both if both.evidence > fitted.evidence + LARGE else fitted


def all_free(point: Point, stage: Stage) -> Point:
    """With all parameters of a stage that are away from doing nothing."""
    assert isinstance(stage, Cause)
    free = {n for id, n in point.names if id == stage.id}
    more = [
        (stage.id, n, abs(stage[n] - stage.neutral.get(n, 0.0)) / stage.sharp.get(n, 1.0))
        for n in stage.parameters
        if n not in free and n not in stage.given and stage[n] != stage.neutral.get(n, 0.0)
    ]  # fmt: skip
    return replace(point, sizes=(*point.sizes, *more))


def _nearest(space: Space, here: Fitted, points: Sequence[Point], id: str) -> Point | None:
    """Of models with a level somewhere else each, the one that leaves least; None if none can be
    played.
    """
    if not points:
        return None
    left = np.full(len(points), np.inf)
    if all(name == id for name, _, _ in points[0].sizes):  # nothing but compliances is to be fitted
        space = plain_space(space.groups, points[0].model, bare=True)
    for _ in range(TWICE):  # some of all, then those about the best of them
        looked = range(0, len(points), EVERY)
        if np.isfinite(left).any():
            k = int(np.argmin(left))
            looked = range(max(k - EVERY + 1, 0), min(k + EVERY, len(points)))
        made = [partial(_left_with, space, points[j], id) for j in looked]
        left[list(looked)] = abreast(space, made, here.parts)
    if not np.isfinite(left).any():
        return None
    k = int(np.argmin(left))
    return _between_levels(space, here, points[max(k - 1, 0) : k + 2], points[k], left[k], id)


def _between_levels(
    space: Space, here: Fitted, beside: Sequence[Point], best: Point, left: float, id: str
) -> Point:
    """The best of some levels, or what leaves less halfway to its neighbours, and halfway again.

    A large level is known to a small share of what lies between two that are tried.
    """
    stage = best.model.stage(id)
    assert isinstance(stage, Cause)
    others = [s for p in beside if p is not best and (s := p.model.stage(id)) is not None]
    apart = [
        {n: other[n] - stage[n] for n in stage.sharp if other[n] != stage[n]} for other in others
    ]  # fmt: skip
    # those of the same kind: one from below is no neighbour of one from above
    apart = [a for a, other in zip(apart, others, strict=True) if len(a) == 1 and all(
        stage.neutral.get(n) not in (stage[n], other[n]) and stage[n] * other[n] > 0.0 for n in a
    )]  # fmt: skip
    share = 1.0
    for _ in range(HALVED if apart else 0):
        share *= 0.5
        points = []
        for steps in apart:
            there = stage.with_values(**{n: stage[n] + share * by for n, by in steps.items()})
            points.append(replace(best, model=best.model.with_stage(there)))
        found = abreast(space, [partial(_left_with, space, p, id) for p in points], here.parts)
        if min(found) < left:
            left, best = min(found), points[int(np.argmin(found))]
            stage = best.model.stage(id)
            assert isinstance(stage, Cause)
    return best


def much_left(space: Space, fitted: Fitted) -> bool:
    """Whether far more is left than noise."""
    mean = square_of(fitted.linear) / max(float(fitted.linear.count.sum()), 1.0)
    return bool(1e3 * np.sqrt(mean) > FAR_OFF * space.noise_nm)


def _left_with(space: Space, point: Point, id: str) -> float:
    """Squared error with the base fitted anew beside a cause as it is begun, um^2."""
    as_it_is = replace(point, sizes=tuple(s for s in point.sizes if s[0] != id))
    try:
        return square_of(refit(space, as_it_is, 1, held=True).linear)
    except (InputError, np.linalg.LinAlgError):
        return np.inf


def plainer(found: Found, id: str, doubted: bool = False) -> Form | None:
    """A form of a cause without a number that the best one has, if it says about as much, or the
    best one is doubted.

    What such a number only follows the noise with predicts nothing: two recordings have any two
    slopes, and a drift that settles between them runs anywhere in a third. Which of the two it is
    is for what was held out to say.
    """
    best = found.chosen[id]
    kind = type(best[1][0])
    number = kind.scanned[0] if issubclass(kind, Cause) else ""
    if number not in best[1][0].parameters:
        return None
    without = [f for f in found.forms[id] if number not in f[1][0].parameters]
    likelihood = found.asking(id)
    likely = [likelihood.evidence(columns) for columns, _ in without]
    if not likely:
        return None
    if not doubted and max(likely) < likelihood.evidence(best[0]) - AS_MUCH:
        return None
    return without[int(np.argmax(likely))]


def refitted(
    space: Space, here: Fitted, found: Found, i: int, plain: Form | None = None
) -> Fitted | None:
    """The model with a cause put in, in its best form or another; None where it comes to nothing.
    """
    candidate = found.candidates[i]
    columns, form = plain or found.chosen[candidate.id]
    try:
        settle(space, here.point)
        point = extended(space, here, candidate, columns, found.likelihood, form)
        promised = found.likelihood.evidence(columns) - found.likelihood.evidence()
        point = begun_best(space, point, candidate.id, form[0], promised)
        fitted = descended(space, point, here, promised)
        large = promised > LARGE or bool(getattr(form[0], "cuts_off", False))
        if large and much_left(space, fitted):
            there = _from_either_end(space, here, found, i, point)
            if there is not point:
                other = descended(space, there, here, promised)
                fitted = max(fitted, other, key=lambda f: f.evidence)
            fitted = _at_the_other_end(space, here, fitted, candidate.id)
        if gained(fitted, here) > LARGE:
            fitted = walked(space, further(space, fitted, candidate.id), candidate.id)
        fitted = beside_kinks(space, fitted, candidate.id)
        fitted = as_late(space, fitted, candidate.id)
        fitted = in_another_form(space, fitted, candidate.id)
        fitted = in_another_shape(space, fitted, candidate.id)
        if promised > LARGE:
            fitted = by_least_squares(space, point, fitted, candidate.id)
        if of_base(candidate.id):
            fitted = instead_of_bend(space, fitted)
    except (InputError, np.linalg.LinAlgError):
        fitted = None  # at the size that the data ask for it cannot even be played
    if fitted is None or does_nothing(space, fitted.point, candidate.id):
        return None
    # how much of a bend there is may be open where one is plain
    if not of_base(candidate.id) and needless(fitted, [candidate.id]) is not None:
        return None
    return fitted
