"""The data as a diagnosis sees them: repeats of one drive together, and what is averaged how.

A *group* is one drive with one history, and every recording of it. Drive-locked effects are
sought in the mean over the group, clock-locked ones in the single recordings. The mean is thinned
to averages of cells, the same for measurement and prediction; beside corners of the drive single
samples are kept (`cells`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes.cause import added_by
from piezo_rig.chain import HalfLoops, Memo, Model, Reads
from piezo_rig.diagnosis.between import Denser, denser
from piezo_rig.diagnosis.cells import Cells, Ranges, cells_of

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Group:
    """One drive with one history, recorded once or several times.

    Attributes
    ----------
    time_s, drive_v : shape (n,)
    measured_um : shape (R, n), one row per recording
    starts_s : shape (R,), when each began
    begun_s : when the first recording of the session began
    history : as `Model.simulate` takes it
    blocks : (first, one past last) sample of stretches with one free offset and a known memory
    loops : its half loops
    condition : its name
    sweeps : for every recording the indices of its sweeps
    earlier : share of the recordings, and the turning points of the drives before them, oldest
        first; empty where the history is not known
    after : for every recording which of those it was played after; empty where they were made alike
    fine : ranges of samples that are not thinned
    reads : of its recordings, one behind the other; None where they begin where the model does
    played : shape (R,), cycles of the session before each recording; None where nobody knows
    alike : whether the recordings were made as if played after the mean of what they were
    denser : the drive with turning points between samples, where it has any
    """

    time_s: FloatArray
    drive_v: FloatArray
    measured_um: FloatArray
    starts_s: FloatArray
    history: str
    blocks: tuple[tuple[int, int], ...]
    loops: HalfLoops
    condition: str
    sweeps: tuple[tuple[int, ...], ...]
    earlier: tuple[tuple[float, tuple[FloatArray, ...]], ...] = ()
    after: tuple[int, ...] = ()
    fine: Ranges = ()
    begun_s: float = 0.0
    reads: tuple[Reads, ...] | None = None
    played: FloatArray | None = None
    alike: bool = False
    denser: Denser | None = None
    memo: Memo = field(default_factory=Memo, init=False, repr=False)
    memos: dict[int, Memo] = field(default_factory=dict, init=False, repr=False)

    @property
    def repeats(self) -> int:
        return int(self.measured_um.shape[0])

    @property
    def virgin(self) -> bool:
        return self.history == "virgin"

    def predicted(self, model: Model) -> FloatArray:
        """What the sensor would show, clock-locked stages of the model included; shape (n,).

        Recordings that were played after different ones are averaged.
        """
        return self.memo.whole(model, lambda: self.predicted_once(model))

    def predicted_once(self, model: Model) -> FloatArray:
        """`predicted` of a model that nobody asks for again."""
        if self.earlier and model.remembering:
            moved = np.zeros(self.drive_v.size)
            for k, (share, _) in enumerate(self.earlier):
                moved += share * self._after(model, k)
        else:
            moved = self._simulated(
                model, memo=self.memo, reads=self.reads, played=self.played
            )
        if any(s.locked_to == "clock" for s in model.stages):
            moved = moved + self.by_the_clock(model)
        return moved

    def without(self, row: int | None) -> list[int]:
        """Its recordings without one, counted round; all of them without none, or of a single one.
        """
        rows = list(range(self.repeats))
        if row is not None and self.repeats > 1:
            rows.pop(row % self.repeats)
        return rows

    def by_the_clock(self, model: Model) -> FloatArray:
        """What clock-locked stages add to the mean of all recordings, shape (n,)."""
        own = [self.clocked(model, row) for row in range(self.repeats)]
        return np.asarray(np.mean(own, axis=0))

    def clocked(self, model: Model, row: int) -> FloatArray:
        """What clock-locked stages add to one recording, shape (n,)."""
        moved = np.zeros(self.drive_v.size)
        time = self.time_s + (self.starts_s[row] - self.begun_s)
        for stage in model.stages:
            if stage.locked_to == "clock":
                moved += added_by(stage, time, self.drive_v)
        return moved

    def _after(self, model: Model, k: int) -> FloatArray:
        """What the sensor would show after some of the drives before, but for the clock."""
        played = self.played
        if played is not None and self.after:
            played = played[np.array(self.after) == k]
        return self._simulated(
            model, memo=self.memos.setdefault(k, Memo()), earlier=self.earlier[k][1], played=played
        )

    def _simulated(self, model: Model, **known: Any) -> FloatArray:
        """`Model.simulate` along the drive, shape (n,)."""
        if self.denser is None:
            return model.simulate(self.time_s, self.drive_v, self.history, **known)
        time, drive, given = self.denser
        return model.simulate(time, drive, self.history, **known)[given]

    def _each(self, model: Model) -> FloatArray:
        """What the sensor would show of every recording, but for the clock, shape (R, n)."""
        if not self._counts(model):
            return np.array([self._after(model, k) for k in range(len(self.earlier))])[
                list(self.after)
            ]
        assert self.played is not None
        after = self.after or (0,) * self.repeats
        return np.array([
            self._simulated(
                model, memo=self.memos.setdefault(-1 - row, Memo()), reads=self.reads,
                earlier=self.earlier[after[row]][1] if self.earlier else (),
                played=self.played[row : row + 1],
            ) for row in range(self.repeats)
        ])  # fmt: skip

    def _counts(self, model: Model) -> bool:
        """Whether the recordings differ by how many cycles a model counts before each."""
        return (
            model.counts_on and self.played is not None and not self.alike
            and bool(np.ptp(self.played) > 0.0)
        )  # fmt: skip

    def remembers(self, model: Model) -> bool:
        """Whether the recordings differ by what a model says is left of those before."""
        return (len(set(self.after)) > 1 and bool(model.remembering)) or self._counts(model)

    def predicted_of(self, model: Model, rows: Sequence[int]) -> FloatArray:
        """`predicted` of some of the recordings."""
        moved, apart = self.predicted(model), self.apart(model)
        return moved if apart is None else moved + apart[list(rows)].mean(axis=0)

    def apart(self, model: Model) -> FloatArray | None:
        """What a model says that each recording is beside their mean, shape (R, n); None of one
        that says the same of all.
        """
        own = list[FloatArray]()
        if any(s.locked_to == "clock" for s in model.stages):
            own.append(np.array([self.clocked(model, row) for row in range(self.repeats)]))
        if self.remembers(model):
            own.append(self._each(model))
        return sum(x - x.mean(axis=0) for x in own) if own else None

    def of_one_history(self, model: Model) -> Group:
        """As if all had been played after the mean of what they were played after."""
        if not self.remembers(model):
            return self
        own = self._each(model)
        return replace(
            self, measured_um=self.measured_um + own.mean(axis=0) - own, after=(), alike=True
        )

    def at_one_time(self, model: Model) -> Group:
        """As if every recording had been made at the mean of their times, after the same drives."""
        apart = self.apart(model)
        return self if apart is None else self.with_measured(self.measured_um - apart)

    def remember(self, model: Model) -> None:
        """Keep what this model makes stage by stage."""
        for memo in (self.memo, *self.memos.values()):
            memo.remember(model)

    def begun(self, samples: int) -> Group:
        """The group up to the last turning point within so many samples of its blocks, two half
        loops of them at least.
        """
        loops, first = self.loops, self.blocks[0][0]
        before = int(np.searchsorted(loops.stop, first, side="right"))
        count = int(np.searchsorted(loops.stop, first + samples, side="right"))
        count = max(count, min(before + 2, len(loops)))
        end = min(int(loops.stop[count - 1]) + 1, self.drive_v.size) if len(loops) else samples
        time, drive = self.time_s[:end], self.drive_v[:end]
        return replace(
            self, time_s=time, drive_v=drive, denser=self.denser and self.denser.before(time[-1]),
            measured_um=self.measured_um[:, :end], loops=loops.first(count),
            reads=self.reads_between(0, end),
            blocks=tuple((a, min(b, end)) for a, b in self.blocks if min(b, end) - a >= 8),
        )  # fmt: skip

    def reads_between(self, begin: int, end: int) -> tuple[Reads, ...] | None:
        """What is known of the recordings along samples begin..end of the drive."""
        if self.reads is None:
            return None
        out, mean = list[Reads](), self.measured_um.mean(axis=0)
        for r in self.reads:
            a, b = np.searchsorted(self.time_s, [r.from_s - 1e-9, r.to_s - 1e-9])
            i, j = max(int(a), begin), min(int(b), end)
            if i >= j:
                continue
            off = float(mean[i:j].mean() - mean[a:b].mean())
            to_s = r.to_s if j == b else float(self.time_s[j - 1]) + 1e-8
            out.append(Reads(float(self.time_s[i]), to_s, r.scale_um + off))
        return tuple(out) or None

    def with_measured(self, measured_um: FloatArray) -> Group:
        return replace(self, measured_um=measured_um)


class Short(NamedTuple):
    """A group whose drive is thinned as its recordings are, and which samples are theirs (n,)."""

    group: Group
    inside: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Groups:
    """All groups, and the factor by which they are thinned.

    ``offset_v`` : the drive at no command; where that is not known, the highest
    ``noise_v`` : what was taken out of the drive
    """

    groups: tuple[Group, ...]
    rate: float
    factor: int
    offset_v: float = 0.0
    noise_v: float = 0.0
    _short: dict[int, tuple[Group, Short]] = field(default_factory=dict, init=False, repr=False)

    @property
    def thinned_rate(self) -> float:
        return self.rate / self.factor

    @property
    def repeats(self) -> int:
        return max(g.repeats for g in self.groups)

    @property
    def samples(self) -> int:
        """Of all recordings, as they were recorded."""
        return sum(g.repeats * (b - a) for g in self.groups for a, b in g.blocks)

    @property
    def travel_um(self) -> float:
        return max(float(np.ptp(g.measured_um[0, a:b])) for g in self.groups for a, b in g.blocks)

    @property
    def span_v(self) -> float:
        return max(float(np.ptp(g.drive_v)) for g in self.groups)

    @property
    def ends_v(self) -> tuple[float, float]:
        """Lowest and highest drive."""
        return (min(float(g.drive_v.min()) for g in self.groups),
                max(float(g.drive_v.max()) for g in self.groups))  # fmt: skip

    @property
    def session_s(self) -> float:
        """From the beginning of the first recording to the end of the last."""
        begun = min(float(g.starts_s.min()) for g in self.groups)
        return max(float(g.starts_s.max() + g.time_s[-1]) for g in self.groups) - begun

    @property
    def has_first_rise(self) -> bool:
        return any(g.virgin for g in self.groups)

    def with_(self, groups: Sequence[Group]) -> Groups:
        return replace(self, groups=tuple(groups))

    @property
    def finest_rate(self) -> float:
        """Samples per second beside corners, if they are kept there."""
        return self.rate if any(g.fine for g in self.groups) else self.thinned_rate

    def turned(self, model: Model) -> Groups | None:
        """The same, with turning points between samples where they may be; None where nowhere.

        ``model`` : whose amplifier may move them
        """
        known = [denser(g.time_s, g.drive_v, model) for g in self.groups]
        if all(k is None for k in known):
            return None
        return self.with_([
            replace(g, denser=k) for g, k in zip(self.groups, known, strict=True)
        ])  # fmt: skip

    def evenly(self) -> Groups:
        """The same, with single samples nowhere."""
        return self.with_([replace(g, fine=()) for g in self.groups])

    def whole(self, samples: int | None = None) -> Groups:
        """The same, not thinned; the beginnings of so many samples in all."""
        groups = self.evenly().groups
        if samples is not None:
            groups = tuple(g.begun(samples // len(groups)) for g in groups)
        return Groups(groups, self.rate, 1, self.offset_v, self.noise_v)

    def cells(self, group: Group) -> list[Cells]:
        """Of each block of a group."""
        return [cells_of(a, b, group.fine, self.factor) for a, b in group.blocks]

    def edges(self, group: Group) -> list[tuple[int, int]]:
        """Blocks of a thinned group: (first, one past last) thinned sample."""
        ends = np.cumsum([0, *(c.size for c in self.cells(group))])
        return [(int(a), int(b)) for a, b in pairwise(ends)]

    def thinned(self, group: Group, values: FloatArray) -> FloatArray:
        """Values (..., n) over the group's blocks, shape (..., m): averages and single samples."""
        parts = [
            cells.shortened(values[..., a:b])
            for (a, b), cells in zip(group.blocks, self.cells(group), strict=True)
        ]
        return np.concatenate(parts, axis=-1)

    def short(self, group: Group) -> Short:
        """What a small change of a model does can be played over far fewer samples.

        What lies outside of the blocks, or is left over at their ends, is not thinned: the
        actuator remembers it.
        """
        known = self._short.get(id(group))
        if known is None:
            known = self._short[id(group)] = group, self._shortened(group)
        return known[1]

    def _shortened(self, group: Group) -> Short:
        if self.factor == 1 and group.blocks == ((0, group.drive_v.size),):
            return Short(group, np.ones(group.drive_v.size, bool))
        parts, inside, at = list[FloatArray](), list[NDArray[np.bool_]](), 0
        both = np.array([group.time_s, group.drive_v])
        for (a, b), cells in zip(group.blocks, self.cells(group), strict=True):
            parts += [both[:, at:a], cells.shortened(both[:, a:b])]
            inside += [np.zeros(a - at, bool), np.ones(cells.size, bool)]
            at = a + len(cells.marks) * self.factor
        parts.append(both[:, at:])
        inside.append(np.zeros(group.drive_v.size - at, bool))
        time, drive = np.ascontiguousarray(np.concatenate(parts, axis=1))
        whole = ((0, time.size),)
        short = replace(group, time_s=time, drive_v=drive, denser=None, blocks=whole, fine=())
        return Short(short, np.concatenate(inside))  # fmt: skip
