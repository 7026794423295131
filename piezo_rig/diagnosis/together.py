"""Shortened drives of all groups, played at once: most of a diagnosis are such plays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Memo, Model
from piezo_rig.chain.drives import Drives
from piezo_rig.diagnosis.groups import Group, Groups, Short

FloatArray = NDArray[np.float64]


@dataclass(eq=False)
class Together:
    """All groups of some data.

    Attributes
    ----------
    each : the groups, shortened
    drives : theirs
    ends : shape (g + 1,), where each begins and the last ends among the samples that are played
    inside : shape (n,), which of those belong to the data
    thinned : shape (g + 1,), the same as ``ends`` among these
    turned : shape (n,), where the half loop that each of them lies in began, among them
    """

    each: Sequence[Short]
    drives: Drives
    ends: NDArray[np.int64]
    inside: NDArray[np.bool_]
    thinned: NDArray[np.int64]
    turned: NDArray[np.int64]
    memo: Memo = field(default_factory=Memo)

    @classmethod
    def of(cls, groups: Groups) -> Together:
        each = [groups.short(g) for g in groups.groups]
        reads = [s.group.reads for s in each]
        played = [s.group.played for s in each if s.group.played is not None]
        drives = Drives.of(
            [(s.group.time_s, s.group.drive_v, s.group.history) for s in each],
            None if all(r is None for r in reads) else reads,
            played if len(played) == len(each) else None,
        )
        sizes = [s.inside.size for s in each]
        kept = [int(s.inside.sum()) for s in each]
        inside, ends = np.concatenate([s.inside for s in each]), np.cumsum([0, *sizes])
        turned = np.concatenate([
            begin + _turned(g, s) for begin, g, s in zip(ends, groups.groups, each, strict=False)
        ])  # fmt: skip
        return cls(each, drives, ends, inside, np.cumsum([0, *kept]), turned)

    def part(self, index: int) -> slice:
        """Where a group's thinned samples are."""
        return slice(int(self.thinned[index]), int(self.thinned[index + 1]))

    def predicted(self, model: Model) -> FloatArray:
        """What the sensor would show, shape (n,): see `Group.predicted`."""
        return self.memo.whole(model, lambda: self.predicted_once(model))

    def predicted_once(self, model: Model) -> FloatArray:
        """`predicted` of a model that nobody asks for again."""
        if model.remembering and any(s.group.earlier for s in self.each):
            return np.concatenate([s.group.predicted_once(model) for s in self.each])
        moved = model.simulate_each(self.drives, self.memo)
        if any(s.locked_to == "clock" for s in model.stages):
            moved = moved + np.concatenate([s.group.by_the_clock(model) for s in self.each])
        return moved

    def remembered(self, model: Model) -> FloatArray:
        """`predicted`, stage by stage kept for the neighbours of this model."""
        self.memo.remember(model)
        for short in self.each:
            short.group.remember(model)
        return self.predicted_once(model)

    def changes(self, base: FloatArray, models: Sequence[Model]) -> FloatArray:
        """What each of these models, asked for once, does beyond a prediction; the data's (k, m).
        """
        out = np.empty((len(models), int(self.thinned[-1])))
        for row, model in zip(out, models, strict=True):
            row[:] = (self.predicted_once(model) - base)[self.inside]
        return out


def _turned(group: Group, short: Short) -> NDArray[np.int64]:
    """Where the half loop of every shortened sample began, shape (n,)."""
    time = short.group.time_s
    at = np.searchsorted(time, group.time_s[group.loops.start] - 1e-9)
    begun = np.zeros(time.size, np.int64)
    begun[at[at < time.size]] = at[at < time.size]
    return np.maximum.accumulate(begun)
