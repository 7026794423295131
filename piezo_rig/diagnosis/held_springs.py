"""A law whose spring keeps its force over turning points, in place of one that begins anew there.

Both are laws of the same cause. How far it is to where a spring with a slider gives way hangs on
its stiffness before as well, so that minor loops, walks and changes of range tell the two apart
(`piezo_rig.chain.held_force`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import product

import numpy as np

from piezo_rig.causes.first_spring import FirstSpring
from piezo_rig.chain import Stage
from piezo_rig.diagnosis.abreast import abreast
from piezo_rig.diagnosis.first_spring import history_v
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.forms import FADES, PLAIN, summit, worth_of
from piezo_rig.diagnosis.likelihood import Likelihood
from piezo_rig.diagnosis.reduction import reduce
from piezo_rig.diagnosis.refit import Fitted, playable, refit, settle
from piezo_rig.diagnosis.space import Space
from piezo_rig.errors import InputError

STIFFER = (1.0, 2.0, 6.0, 30.0)  # springs, by the largest change that the law makes of them
FURTHER = 1.25 ** np.arange(-3, 7)  # reaches, by that of the law which begins anew
NO_LESS = 30.0  # log-likelihood by which a linear look may say less of a form that is fitted
STEPS = 4  # of a refit


def with_force_kept(space: Space, fitted: Fitted, id: str, than: Fitted) -> Fitted:
    """The law with its spring's force kept, in whichever form of it says plainly more.

    Parameters
    ----------
    than : the model without the law
    """
    stage = fitted.point.model.stage(id)
    if (
        not isinstance(stage, FirstSpring) or "spring" not in stage.optional or stage.holds_force
        or "reach" not in stage.parameters or fitted.evidence < than.evidence + PLAIN
    ):  # fmt: skip
        return fitted
    less = than.point.model
    tried = [stage, *(s for s in forms_of(space, stage) if playable(space, less.with_stage(s)))]
    worth = _looked_at(space, than, tried)
    best: dict[tuple[float, float], int] = {}
    for k, s in enumerate(tried[1:], 1):
        kind = s["at_force"], s["from_rest"]
        if kind not in best or worth[k] > worth[best[kind]]:
            best[kind] = k
    likely = [tried[k] for k in best.values() if worth[k] > max(worth) - NO_LESS]
    found = abreast(space, [partial(_begun, space, fitted, s) for s in likely], fitted.parts)
    there = max([fitted, *(f for f in found if f is not None)], key=lambda f: worth_of(f, id))
    return there if worth_of(there, id) > worth_of(fitted, id) + FADES else fitted


def forms_of(space: Space, stage: FirstSpring) -> list[Stage]:
    """Of every form some, with springs and reaches about what the law at hand asks for; none where
    it follows what is always the same.
    """
    history = history_v(space, stage)
    if not history.size or not np.ptp(history) > 0.0:
        return []  # it changes no spring
    mean = float(history.mean())
    most = float(np.abs(history - mean).max())
    rises = (0.0, 1.0) if space.groups.has_first_rise else (0.0,)
    out = []
    for at_force, from_rest, stiffer, further in product((0.0, 1.0), rises, STIFFER, FURTHER):
        slope = stage["slope"] / float(further)  # it holds back as much, over another reach
        spring = stiffer * abs(slope) * most
        out.append(stage.with_values(
            slope=slope, offset=spring - slope * mean, reach=float(further * stage["reach"]),
            closing=0.0, taper=0.0, carries=1.0, spring=spring, at_force=at_force,
            from_rest=from_rest,
        ))  # fmt: skip
    return out


def _looked_at(space: Space, than: Fitted, tried: Sequence[Stage]) -> list[float]:
    """Log-likelihood that a linear look says each gains about the model without the law."""
    settle(space, than.point)
    model = than.point.model
    pairs = [(model, model.with_stage(s)) for s in tried]
    likelihood = Likelihood(reduce(space.linear(than.point, pairs)))
    return [likelihood.evidence([k]) for k in range(len(tried))]


def _begun(space: Space, fitted: Fitted, stage: Stage) -> Fitted | None:
    """Refitted in that form, at its best reach; None where it cannot be played."""
    id = stage.id
    sizes = [s for s in fitted.point.sizes if s[:2] != (id, "offset")]
    point = Point(
        fitted.point.model.with_stage(stage), fitted.point.fixed,
        (*sizes, (id, "offset", 0.1 * stage["spring"])),
    )  # fmt: skip
    try:
        return summit(space, refit(space, point, STEPS, held=True), id)
    except (InputError, np.linalg.LinAlgError):
        return None
