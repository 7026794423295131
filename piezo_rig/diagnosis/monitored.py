"""What the drive monitor says, brought into the search: causes taken as read, causes ruled out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.chain import Parameter, Stage
from piezo_rig.diagnosis.context import context_of
from piezo_rig.diagnosis.early import Reading
from piezo_rig.diagnosis.early.monitor import LAG, SKEW
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.forms import beside_kinks
from piezo_rig.diagnosis.ladder import Ladder, Step
from piezo_rig.diagnosis.reduction import reduce
from piezo_rig.diagnosis.refit import Fitted, playable, refit, settle
from piezo_rig.diagnosis.scan import VISIBLE
from piezo_rig.diagnosis.space import Space
from piezo_rig.diagnosis.spare import NEEDED

PLAIN = 300.0  # log-likelihood by which a delay is beyond doubt after one step without it
ELSE, UNLIKE = 5.0, 0.25  # standard errors, and share of a delay, by which it is another one


def taken_in(space: Space, first: Fitted, reading: Reading) -> tuple[list[Step], list[str]]:
    """Rungs that the monitor gives, in order, and what is to be said of those it does not.

    An amplifier's law that the displacement can show goes into the model with the monitor's
    values, and stays there. So does a delay while the ladder is climbed (`freed`). What cannot be
    seen in the displacement is left out; neither that nor what the monitor rules out is looked for
    any more (`Space.excluded`).
    """
    steps, notes, here = list[Step](), list[str](), first
    for told in reading.told:
        id = told.stage.id
        if here.point.model.stage(id) is not None:
            continue
        d_prime = visible(space, here.point, told.stage)
        values = ", ".join(_said(n, p) for n, p in told.stage.reported(np.zeros((9, 9))).items())  # type: ignore[attr-defined]
        if d_prime < VISIBLE:
            notes.append(f"drive monitor: {id}, {values}: too small to be seen in the displacement")
            if id != SKEW:
                space.excluded[id] = f"the drive monitor shows {values}: too small to be seen"
            continue
        model = here.point.model.with_stage(told.stage)
        here = refit(space, replace(here.point, model=model), held=True)
        steps.append(Step(id, min(told.p_value, 1.0), here))
    late = any(t.stage.id == SKEW for t in reading.told)
    for id, stages in reading.bounds.items():
        if here.point.model.stage(id) is not None:
            continue
        kind = CAUSES[id]
        assert issubclass(kind, Cause)
        if kind.lasting:  # the monitor would have shown a longer one
            space.longest[id] = max(s[kind.lasting] for s in stages)
        if max(visible(space, here.point, s) for s in stages) < VISIBLE:
            least = ", ".join(
                _said(n, p) for s in stages for n, p in s.parameters.items()
                if p.value != kind.neutral.get(n)
            )  # fmt: skip
            space.excluded[id] = (
                "the drive monitor shows no more than a delay" if id == LAG and late
                else f"the drive monitor shows none: it would have shown {least}"
            )
    return steps, notes


def visible(space: Space, point: Point, stage: Stage) -> float:
    """d' of a stage against the noise alone, with all that the base can do projected off."""
    model = point.model.with_stage(stage)
    if not playable(space, model):
        return np.inf
    settle(space, point)
    reduced = reduce(space.linear(point, [(point.model, model)]))
    return float(np.linalg.norm(reduced.trials[:, 0]))


def freed(space: Space, ladder: Ladder) -> Ladder:
    """The ladder with a delay that the monitor gave fitted to the displacement at its end.

    The sensor may be later than the monitor, or the monitor's own channel slow. Before everything
    else is explained, a free delay would make up for what is not.
    """
    last = ladder.last
    kind = CAUSES[SKEW]
    assert issubclass(kind, Cause)
    model = last.point.model
    if model.stage(SKEW) is None or any(id == SKEW for id, _ in last.point.names):
        return ladder
    (trial,) = kind.trials(context_of(space, model))
    sizes = (*last.point.sizes, (SKEW, kind.kinked, trial[kind.kinked]))
    there = refit(space, replace(last.point, sizes=sizes), held=True)
    there = beside_kinks(space, there, SKEW)
    if there.evidence < last.evidence + NEEDED:
        return ladder
    if not ladder.steps:
        return replace(ladder, first=there)
    steps = (*ladder.steps[:-1], replace(ladder.steps[-1], fitted=there))
    return replace(ladder, steps=steps)


def corrected(space: Space, ladder: Ladder, reading: Reading) -> tuple[Reading, str] | None:
    """What the displacement makes of the monitor's delay, and why; None if it agrees.

    A delay that does the displacement no good is the monitor's own and is left out; one that comes
    out quite different is the displacement's. What was found beside the wrong one may be wrong.
    """
    told = next((t for t in reading.told if t.stage.id == SKEW), None)
    last = ladder.last
    stage = last.point.model.stage(SKEW)
    if told is None or stage is None or reading.settled or SKEW in last.point.fixed:
        return None
    seen, others = told.stage["delay"], tuple(t for t in reading.told if t is not told)
    less = refit(space, last.point.without(SKEW), steps=1, held=True)
    if less.evidence + PLAIN >= last.evidence:
        less = refit(space, less.point, held=True)
    if less.evidence + NEEDED >= last.evidence:
        return replace(reading, told=others, settled=True), (
            f"the drive monitor is late by {1e3 * seen:.4g} ms, the displacement is not: that "
            "delay is of the monitor's own channel, and is no finding"
        )
    index = next((j for j, (id, _) in enumerate(last.point.names) if id == SKEW), None)
    off = abs(stage["delay"] - seen)
    if index is None or off < max(
        ELSE * float(np.sqrt(last.covariance[index, index])), UNLIKE * abs(seen)
    ):
        return None
    own = replace(told, stage=with_intervals(last, SKEW))
    return replace(reading, told=(*others, own), settled=True), (
        f"the drive monitor is late by {1e3 * seen:.4g} ms, the displacement by "
        f"{1e3 * stage['delay']:.4g} ms: the displacement is what counts, and the rest is of the "
        "monitor's or the sensor's own channel"
    )


def with_intervals(last: Fitted, cause: str) -> Stage:
    """A stage whose parameters carry the intervals of its fit."""
    stage = last.point.model.stage(cause)
    assert stage is not None
    own = {}
    for j, (id, name) in enumerate(last.point.names):
        if id == cause:
            half = 1.96 * float(np.sqrt(max(last.covariance[j, j], 0.0)))
            value = stage[name]
            own[name] = Parameter(value, stage.parameters[name].unit, (value - half, value + half))
    return type(stage)(stage.parameters | own, stage.elements)


def _said(name: str, p: Parameter) -> str:
    return f"{name} {p.value:.3g} {p.unit}"
