"""Recordings of one drive that were not sampled in step with it, put in step.

A generator and a digitizer without a common clock begin every repeat at another part of a sample.
Sample by sample repeats then differ by what the actuator moves in that part, up and down alike,
which is no noise; their mean has round corners, which no drive had. The drive column says how far
each was off. What a model says of each one's own drive, less what it says of one of them, is taken
off its measurement, which is as if all had been sampled at the moments of that one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.diagnosis.between import denser
from piezo_rig.diagnosis.groups import Group, Groups
from piezo_rig.identification.data import Track

FloatArray = NDArray[np.float64]
STEP = 0.05  # of a sample's usual change, by which drives must differ to be out of step
SEEN = 0.1  # rms of what that makes, of what recordings differ by
NEAR_ONE = 0.3  # how far its share in what they differ by may be from one
PLAINLY = 10.0  # log-likelihood by which drives must be seen to turn between samples
LOST = 20  # samples in one place, at most
AGAIN = 10  # samples that are the same after some were lost


class InStep(NamedTuple):
    """``groups`` in step, and whether their drives turn ``between`` samples by what they show."""

    groups: Groups
    between: bool


class _Taken(NamedTuple):
    """Groups without what drives say, and of that its part in what is found, and its square; the
    square of what is found, and how many samples say so.
    """

    groups: tuple[Group, ...]
    seen: float
    itself: float
    found: float
    samples: int

    @property
    def left(self) -> float:
        return self.found - 2.0 * self.seen + self.itself


def out_of_step(groups: Groups, tracks: Sequence[Track]) -> dict[int, FloatArray]:
    """Of groups whose recordings have drives of their own, by their number: those drives, (R, n).

    A recording whose drive lost whole samples is as it was: its drive is the mean of the group.

    Parameters
    ----------
    tracks : that the groups are made of
    """
    of = {t.sweeps: t for t in tracks}
    out = {}
    for k, g in enumerate(groups.groups):
        own = _own_drives(g, [of[s].drive_v[: g.drive_v.size] for s in g.sweeps])
        if own is not None:
            out[k] = own
    return out


def in_step(groups: Groups, drives: Mapping[int, FloatArray], model: Model) -> InStep | None:
    """The same with repeats as if sampled in step; None where what they differ by does not follow
    from their drives.

    Parameters
    ----------
    drives : of those that are not in step
    model : fitted to the groups as they are
    """
    as_said = _taken_off(groups, drives, model, between=False)
    turned = _taken_off(groups, drives, model, between=True)
    best = min(as_said, turned, key=lambda t: t.left)
    usual = max(best.left / max(best.samples, 1), 1e-300)
    if 0.5 * (as_said.left - best.left) / usual < PLAINLY:
        best = as_said
    if best.itself <= SEEN**2 * best.found or abs(best.seen / best.itself - 1.0) > NEAR_ONE:
        return None
    return InStep(groups.with_(best.groups), best is turned)


def _taken_off(
    groups: Groups, drives: Mapping[int, FloatArray], model: Model, between: bool
) -> _Taken:
    """``between`` : drives turn between samples, where they may."""
    changed, samples = list(groups.groups), 0
    seen = itself = found = 0.0
    for k, own in drives.items():
        g = groups.groups[k]
        made = np.array([_predicted(g, drive, model, between) for drive in own])
        first = int(np.argmin(np.mean((own - g.drive_v) ** 2, axis=1)))  # the likest to their mean
        measured = g.measured_um - (made - made[first])
        changed[k] = replace(g, drive_v=own[first], measured_um=measured)
        said, differ = _apart(g, made), _apart(g, g.measured_um)
        seen += float(np.sum(said * differ))
        itself += float(np.sum(said**2))
        found += float(np.sum(differ**2))
        samples += (g.repeats - 1) * said.shape[1]
    return _Taken(tuple(changed), seen, itself, found, samples)


def _own_drives(group: Group, own: Sequence[FloatArray]) -> FloatArray | None:
    """What every recording's drive was, shape (R, n); None where all are the same."""
    if group.repeats < 2:
        return None
    usual = float(np.median(np.abs(np.diff(own[0]))))
    if max(float(np.max(np.abs(row - own[0]))) for row in own) <= STEP * usual:
        return None
    kept = [lost(own[0], row, STEP * usual) or lost(row, own[0], STEP * usual) for row in own]
    if all(kept[1:]):
        return None
    return np.array([group.drive_v if out else row for row, out in zip(own, kept, strict=True)])


def lost(whole: FloatArray, row: FloatArray, within: float) -> bool:
    """Whether a drive is another less some samples, and otherwise the same but for its end."""
    at = behind = 0
    while at + behind < whole.size and at < row.size:
        same = np.abs(whole[at + behind :][: row.size - at] - row[at : whole.size - behind])
        off = np.flatnonzero(same > within)
        if not off.size:
            return behind > 0
        at += int(off[0])
        for more in range(1, LOST + 1):
            ahead = whole[at + behind + more :][:AGAIN]
            if ahead.size and np.all(np.abs(ahead - row[at:][: ahead.size]) <= within):
                behind += more
                break
        else:
            return False
    return behind > 0


def _predicted(group: Group, drive: FloatArray, model: Model, between: bool) -> FloatArray:
    turned = denser(group.time_s, drive, model) if between else None
    return replace(group, drive_v=drive, denser=turned).predicted(model)


def _apart(group: Group, rows: FloatArray) -> FloatArray:
    """Rows (R, n) over its blocks, beside their means and that of all of them."""
    out = [rows[:, a:b] - rows[:, a:b].mean(axis=1, keepdims=True) for a, b in group.blocks]
    cut = np.concatenate(out, axis=1)
    return np.asarray(cut - cut.mean(axis=0))
