"""Many recordings: a part of them at a rate that shows what happens at corners, then all of them.

All samples of a large matrix, thinned until they fit, no longer show a mode that rings or a delay
of one sample; at full rate a few recordings of every range do. So the ladder is climbed on such a
part. All recordings then start from where it ended: what they know better is fitted anew and
anything that is still missing is sought in them; what only the part can show is kept as it was
found there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from piezo_rig.chain import Parameter, Stage
from piezo_rig.diagnosis.climb import Step
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.groups import ENOUGH, Group, Groups
from piezo_rig.diagnosis.refit import Fitted, known_of, refit
from piezo_rig.diagnosis.space import Space

if TYPE_CHECKING:
    from piezo_rig.diagnosis.climbed import Climbed

FAST_HZ = 2000.0  # samples per second that show corners
LEAST = 8  # drives, where there are as many


def part_of(groups: Groups) -> Groups | None:
    """The beginnings of some of many recordings, thinned little; None where all show corners.

    Drives are taken evenly from the smallest to the largest range, the largest among them.
    """
    if groups.factor == 1 or groups.thinned_rate >= FAST_HZ:
        return None
    factor = max(1, int(groups.rate / (2.0 * FAST_HZ)))
    room = ENOUGH * factor
    least = min(len(groups.groups), LEAST)
    begun = [_beginning(g, room // least) for g in groups.groups]
    count = max(least, int(room / np.mean([g.drive_v.size for g in begun])))
    # a drive that cycles high up has risen there once: what it cycles over is its range
    wide = sorted(range(len(begun)), key=lambda k: (np.median(begun[k].loops.range_v), k))
    picked = np.unique(np.linspace(0, len(wide) - 1, min(count, len(wide))).round().astype(int))
    return Groups(tuple(begun[k] for k in sorted(wide[i] for i in picked)), groups.rate, factor)


def _beginning(group: Group, samples: int) -> Group:
    """A group up to the last turning point within so many samples, at least two half loops."""
    loops = group.loops
    count = max(int(np.searchsorted(loops.stop, samples, side="right")), min(2, len(loops)))
    end = min(int(loops.stop[count - 1]) + 1, group.drive_v.size) if len(loops) else samples
    blocks = tuple((a, min(b, end)) for a, b in group.blocks if min(b, end) - a >= 8)
    return replace(
        group, time_s=group.time_s[:end], drive_v=group.drive_v[:end],
        measured_um=group.measured_um[:, :end], blocks=blocks,
        loops=loops.first(count),
    )  # fmt: skip


def carried_over(space: Space, first: Fitted, part: Climbed) -> tuple[list[Step], list[Step]]:
    """What was found in a part, fitted to all recordings.

    Returns
    -------
    held : rungs, in order: what the drive monitor gave, and causes whose parameters the part knows
        better, which stay as they are
    steps : the others, free; each as it stands in the whole ladder
    """
    last, held, base = part.ladder.last, list[Step](), first
    monitored = {s.cause for s in part.monitored}
    fine = finer(space, last)
    found = [*part.monitored, *part.ladder.steps]
    for step in found:
        if step.cause in fine | monitored:
            stage = with_intervals(last, step.cause)
            free = [] if step.cause in fine else _sizes(last, {step.cause})
            base = refit(space, _with(base.point, [stage], free), held=True)
            held.append(replace(step, fitted=base))
    free_ids = {s.cause for s in found} - fine - monitored
    if not free_ids:
        return held, []
    stages = [s for s in last.point.model.stages if s.id in free_ids]
    full = refit(space, _with(base.point, stages, _sizes(last, free_ids)), held=True)
    return held, [replace(s, fitted=full) for s in found if s.cause in free_ids]


def _sizes(fitted: Fitted, ids: set[str]) -> list[tuple[str, str, float]]:
    return [s for s in fitted.point.sizes if s[0] in ids]


def _with(point: Point, stages: Sequence[Stage], sizes: Sequence[tuple[str, str, float]]) -> Point:
    model = point.model
    for stage in stages:
        model = model.with_stage(stage)
    return Point(model, point.fixed, (*point.sizes, *sizes))


def finer(space: Space, last: Fitted) -> set[str]:
    """Causes of a model that was fitted elsewhere whose parameters these data know less well."""
    here = known_of(space, last.point)
    out = set()
    for j, (id, name) in enumerate(last.point.names):
        stage = last.point.model.stage(id)
        if stage is not None and name not in stage.optional and here[j] > last.covariance[j, j]:
            out.add(id)
    return out


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
