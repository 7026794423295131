"""Creep that goes on from one recording to the next.

An actuator creeps on at rest. What a recording left of its relaxations is still there when the next
begins a few seconds later, and dies away during it, against what creeps then. A model that begins
every recording settled finds the rate too low by that: a tenth of it over triangles of 2 Hz with
1.5 s in between. Relaxations are linear in the displacement, so what is left of them follows from
the recordings before, one by one; it is taken off where the data say that it is there.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes.creep import Creep
from piezo_rig.chain.relaxation import relaxations_each
from piezo_rig.diagnosis.groups import Group, Groups
from piezo_rig.diagnosis.refit import Fitted, refit

FloatArray = NDArray[np.float64]
NEEDED = 3.0  # log-likelihood that decides between models
SAME_PLACE = 0.02  # of the range of all drives, by which one may begin beside where another ended
TURNS = 3  # of taking it off and fitting the rate


class Less(NamedTuple):
    """Recordings ``groups`` without what creeps on, and ``fitted`` to them as in its space."""

    groups: Groups
    fitted: Fitted


def less_what_creeps_on(fitted: Fitted, groups: Groups) -> Less | None:
    """Recordings without what creep of those before still does in them.

    None where nothing creeps, where it is not known what was before, and where without it they say
    less.

    Parameters
    ----------
    fitted : to recordings with the same drives
    """
    space, point = fitted.space, fitted.point
    stage = point.model.stage(Creep.id)
    if not isinstance(stage, Creep) or point.fixed:
        return None
    left = left_before(groups, stage.times_s)
    if left is None:
        return None
    if _most(groups, left, stage, space.sample_noise_nm) < NEEDED:
        return None
    there, better = fitted, groups
    for _ in range(TURNS):
        stage = there.point.model.stage(Creep.id)
        assert isinstance(stage, Creep)
        again = space.with_measured(_less(space.groups, left, stage))
        there = refit(again, there.point, held=True)
        better = _less(groups, left, stage)
        if there.evidence < fitted.evidence:
            return None
    return Less(better, there) if there.evidence > fitted.evidence + NEEDED else None


def left_before(groups: Groups, times_s: FloatArray) -> list[FloatArray] | None:
    """How far every relaxation is behind where each recording begins, um, (R, k) of each group.

    In between the actuator stays where the recording before ended. None where that is not where
    the next begins, or nobody knows when.
    """
    every = sorted(
        (float(start), k, row)
        for k, g in enumerate(groups.groups) for row, start in enumerate(g.starts_s)
    )  # fmt: skip
    if len(every) < 2 or any(len(s) > 1 for g in groups.groups for s in g.sweeps):
        return None
    out = [np.zeros((g.repeats, times_s.size)) for g in groups.groups]
    behind, ended_s, ended_v = np.zeros(times_s.size), every[0][0], None
    for start, k, row in every:
        g = groups.groups[k]
        rested = start - ended_s
        if rested < -0.5 / groups.rate or not (
            ended_v is None or abs(g.drive_v[0] - ended_v) <= SAME_PLACE * groups.span_v
        ):
            return None
        behind = behind * np.exp(-max(rested, 0.0) / times_s)
        out[k][row] = behind
        behind = _behind_at_the_end(g, row, behind, times_s)
        ended_s, ended_v = start + float(g.time_s[-1] - g.time_s[0]), float(g.drive_v[-1])
    return out


def _behind_at_the_end(
    group: Group, row: int, behind: FloatArray, times_s: FloatArray
) -> FloatArray:
    """Relaxations less the place where a recording ends, from those less where it begins, (k,)."""
    x = group.measured_um[row] - group.measured_um[row][0]
    time = np.ascontiguousarray(group.time_s)
    each = np.empty((x.size, times_s.size))
    relaxations_each(np.zeros(1, np.int64), time, np.ascontiguousarray(x), times_s, each)
    kept = behind * np.exp(-float(time[-1] - time[0]) / times_s)
    return np.asarray(each[-1] + kept - x[-1])


def _most(groups: Groups, left: list[FloatArray], stage: Creep, noise_nm: float) -> float:
    """Log-likelihood that taking it off can bring where all of it is amiss."""
    square = 0.0
    for g, less in zip(groups.groups, _less(groups, left, stage).groups, strict=True):
        for a, b in g.blocks:
            off = (g.measured_um - less.measured_um)[:, a:b]
            square += float(np.sum((off - off.mean(axis=1, keepdims=True)) ** 2))
    return 0.5 * 1e6 * square / max(noise_nm, 1e-9) ** 2


def _less(groups: Groups, left: list[FloatArray], stage: Creep) -> Groups:
    out = []
    for g, rows in zip(groups.groups, left, strict=True):
        since = g.time_s - g.time_s[0]
        fading = np.expm1(-since / stage.times_s[:, None])  # from where each recording begins
        out.append(replace(g, measured_um=g.measured_um - (rows * stage.shares) @ fading))
    return groups.with_(out)
