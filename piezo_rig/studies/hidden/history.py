"""What an actuator owes to what was played before: cycles, and the recording before this one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from piezo_rig.studies.hidden import kernels
from piezo_rig.studies.hidden.body import Body
from piezo_rig.studies.hidden.effects import Effect

FloatArray = NDArray[np.float64]


def half_cycles(drive_v: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Of every step of a drive (n,): its half cycle 0, 1, .. and the share of that behind it.

    Both of shape (n - 1,). The drive is clean: every reversal counts.
    """
    steps = np.diff(drive_v)
    way = np.sign(steps)
    moving = np.flatnonzero(way)
    for i in moving[0] + 1 + np.flatnonzero(way[moving[0] + 1 :] == 0.0):
        way[i] = way[i - 1]  # a hold belongs to the half cycle before it
    way[: moving[0]] = way[moving[0]]
    number = np.concatenate([[0], np.cumsum(way[1:] != way[:-1])]).astype(np.int64)
    done = np.cumsum(np.abs(steps))
    ends = np.append(np.flatnonzero(np.diff(number)), number.size - 1)
    upto = np.concatenate([[0.0], done[ends]])
    length = np.maximum(np.diff(upto), 1e-12)
    return number, (done - upto[number]) / length[number]


@dataclass(frozen=True, eq=False)
class CycleAging(Effect):
    """A: the stroke of cycle n is 1 + size log10(n) times its own. B: the hysteretic strain alone
    grows, all the time, and saturates after one to four cycles.

    The count begins with every recording: the rest before it clears it with the memory.
    Size: A, per decade; B, the whole of it.
    """

    sign: float = 1.0
    cycles: float = 2.0

    cause: ClassVar[str] = "cycle-aging"
    forms: ClassVar[tuple[str, ...]] = ("A", "B")
    most: ClassVar[float] = 0.2

    @classmethod
    def drawn(cls, rng: np.random.Generator, form: str) -> Self:
        return cls(0.0, form, float(rng.choice([-1.0, 1.0])), float(rng.uniform(1.0, 4.0)))

    def parameters(self, body: Body, seconds: float) -> dict[str, float]:
        return {"rate_per_decade": self.sign * self.size} if self.form == "A" else {}

    def on_body(
        self, body: Body, time: FloatArray, drive: FloatArray, base: FloatArray
    ) -> FloatArray | None:
        number, share = half_cycles(drive)
        if self.form == "A":
            longer = self.sign * self.size * np.log10(1 + number // 2)
            return base + np.append(0.0, np.cumsum(longer * np.diff(base)))
        played = np.append(0.0, 0.5 * (number + share))
        hysteretic = base - body.compliance * drive - body.bent(drive)
        return base - self.sign * self.size * np.expm1(-played / self.cycles) * hysteretic


@dataclass(frozen=True, eq=False)
class Remanence(Effect):
    """A: every recording begins with a share of the state that each play operator had at the end
    of the one before. B: a share of the domains has kept its memory whole, the others none of it.

    Size: that share.
    """

    body: Body | None = None
    drives: tuple[FloatArray, ...] = ()

    cause: ClassVar[str] = "remanence"
    forms: ClassVar[tuple[str, ...]] = ("A", "B")
    start: ClassVar[float] = 0.01
    most: ClassVar[float] = 0.8
    clock_locked: ClassVar[bool] = True

    def placed(self, body: Body, drives: Sequence[FloatArray]) -> Self:
        return replace(self, body=body, drives=tuple(drives))

    def parameters(self, body: Body, seconds: float) -> dict[str, float]:
        return {"fraction": self.size} if self.form == "A" else {}

    @cached_property
    def _changes(self) -> list[FloatArray]:
        assert self.body is not None
        thresholds, weights = self.body.thresholds, self.body.weights
        out = []
        kept = np.zeros(thresholds.size)  # memory of those domains that keep it
        for drive in self.drives:
            virgin = kernels.played_on(drive, thresholds, np.zeros(thresholds.size))
            if self.form == "A":
                kept *= self.size
            played = kernels.played_on(drive, thresholds, kept)
            change = (played - played[0] - virgin + virgin[0]) @ weights
            out.append(change if self.form == "A" else self.size * change)
        return out

    def on_recording(self, recording: int) -> FloatArray | None:
        return self._changes[recording] if self.size else None


HISTORY: dict[str, type[Effect]] = {e.cause: e for e in (CycleAging, Remanence)}
