"""A clock that runs off, which losses halfway through recordings are taken for.

What is late by more and more is late by half as much before the middle, and early by as much after
it, once a base has followed: a loss in the middle takes off three quarters of that. So whoever
finds losses asks what a clock leaves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from piezo_rig.causes.clock_ratio import ClockRatio
from piezo_rig.diagnosis.early.mended import DROP, Break, mended
from piezo_rig.diagnosis.early.recounted import square_of
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.groups import Groups

BY_THE_END = 1.5  # of the samples lost in the middle, that the clock is off by at the end
EXAMPLE = 1.0  # ppm


def rather_a_clock(
    groups: Groups, point: Point, breaks: Sequence[Break], least: float,
    refitted: Callable[[Groups, Point], Point],
) -> bool:  # fmt: skip
    """Whether a clock leaves less of recordings of their own than what losses in them leave.

    ``least`` : squared error with the losses, um^2, over the groups that have breaks
    """
    losses = [b for b in breaks if b.cause == DROP]
    if not losses or point.model.stage(ClockRatio.id) is not None:
        return False
    others = [b for b in breaks if b.cause != DROP]
    whole = mended(groups, [g.predicted(point.model) for g in groups.groups], others)
    members = {b.group for b in breaks}
    most = max(b.count / groups.groups[b.group].drive_v.size for b in losses)
    for sign in (1.0, -1.0):
        clock = ClockRatio.of(None, ppm=1e6 * sign * BY_THE_END * most)
        tried = replace(
            point, model=point.model.with_stage(clock),
            sizes=(*point.sizes, (ClockRatio.id, "ppm", EXAMPLE)),
        )  # fmt: skip
        if square_of(whole, refitted(whole, tried), members) < least:
            return True
    return False
