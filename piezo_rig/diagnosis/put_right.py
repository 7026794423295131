"""A given model that a wrong gain, or a wrong sensitivity, brings home.

Either changes the displacement everywhere, by many times what such a model was off by itself. What
it is off by goes nowhere near as far, but in any direction, also in theirs; a likelihood that
reckons with that may prefer another cause of each of its kinks to one number for all that has
changed. Where everything that was found leaves the model far off, plain least squares is asked
whether that number alone brings it back to where it was at home.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.chain import Parameter
from piezo_rig.diagnosis.chances import fisher_above
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.ladder import Step
from piezo_rig.diagnosis.refit import Fitted, changed_um, refit
from piezo_rig.diagnosis.scan import candidates
from piezo_rig.diagnosis.space import Space
from piezo_rig.errors import InputError

FAR_OFF = 2.0  # times the noise
AT_HOME = 2.0  # times what the model was off by itself, beside the noise
SAME = 1.01  # of an error: as large
STEP = 0.002  # of the ratio, for differences


def put_right(
    space: Space, first: Fitted, left_nm: float, noise_nm: float,
    error_nm: Callable[[Fitted], float],
) -> Step | None:
    """The gain or sensitivity that brings a given model home, held at its value; None if none does.

    Parameters
    ----------
    first : the given model
    left_nm, noise_nm : held-out error with everything that was found; of one recording
    error_nm : held-out error of any other fit

    The interval reaches as far as what the model was off by itself could move the ratio, if all
    of that were like it.
    """
    home_nm = float(np.hypot(noise_nm, AT_HOME * 1e3 * space.own_um))
    if not np.isfinite(home_nm) or left_nm < max(FAR_OFF * noise_nm, home_nm):
        return None
    space.held, loose, space.loose = True, space.loose, False  # a bend would do for most of it
    home: list[tuple[float, str, Fitted]] = []
    for candidate in candidates(space, first.point.model)[0]:
        kind = CAUSES[candidate.id]
        if not (issubclass(kind, Cause) and kind.needs_fixed_model):
            continue
        fits = []
        for form in candidate.variants:
            model = first.point.model.with_stage(form[0])
            point = Point(model, first.point.fixed, ((candidate.id, "ratio", STEP),))
            try:
                fitted = refit(space, point, held=True, plain=True)
                fits.append((error_nm(fitted), candidate.id, fitted))
            except (InputError, np.linalg.LinAlgError):
                continue
        # of forms that leave as much the first
        home += [one for one in fits if one[0] < min(home_nm, *(SAME * f[0] for f in fits))][:1]
    if not home:
        space.loose = loose
        return None
    home.sort(key=lambda one: one[0])
    _, id, best = home[0]
    others = {other: 0.0 for _, other, _ in home[1:]}
    return Step(id, _chance(left_nm, home[0][0], space), _held(space, first, id, best), others)


def _held(space: Space, first: Fitted, id: str, fitted: Fitted) -> Fitted:
    """The given model with the ratio as a part of it, and its interval."""
    stage = fitted.point.model.stage(id)
    assert stage is not None
    ratio, off = stage["ratio"], abs(stage["ratio"] - 1.0)
    moved_um = changed_um(space, first.point.model, fitted.point.model)
    own = space.own_um * off / max(moved_um, 1e-300)
    half = 1.96 * float(np.hypot(np.sqrt(fitted.covariance[0, 0]), own))
    told = Parameter(ratio, stage.parameters["ratio"].unit, (ratio - half, ratio + half))
    known = type(stage)({**stage.parameters, "ratio": told}, stage.elements)
    fixed = (*first.point.fixed, id)
    point = Point(fitted.point.model.with_stage(known), fixed)
    return refit(space, replace(point, sizes=()), held=True)


def _chance(before_nm: float, after_nm: float, space: Space) -> float:
    """Of as large a fall of the squared error by one number for nothing, corrected for all causes.

    Each recording counts as one datum: what samples of one share is not known.
    """
    rest = max(sum(g.repeats for g in space.groups.groups) - 1, 1)
    ratio = rest * (before_nm**2 - after_nm**2) / after_nm**2
    causes = sum(1 for k in CAUSES.values() if issubclass(k, Cause))
    return min(1.0, causes * float(fisher_above(ratio, 1, rest)))
