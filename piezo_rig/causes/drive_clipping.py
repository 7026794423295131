"""Drive clipping: the amplifier saturates inside the commanded range.

Physics: a supply that sags, a voltage limit that was set too low, an offset that is off: the drive
stays at the limit while the command goes on, and comes back with it.

Shows as: a flat displacement (but for creep) where the command is beyond the limit. The
hysteresis starts back from the limit: behind the flat stretch the displacement falls as after any
turning point, steeply or not by its history. A clipped sensor hides a motion that went on; where
it lets go, the actuator is long on its way back.

A limit above 0 V holds the actuator there before anything is played. Either its memory is empty
there, or it was at 0 V (``empty_at_v``) and the first volts of its first rise are behind it: the
data decide.

Remedy: Stay within the limits that are named, or raise the amplifier's rail; what was asked for
beyond them was never played.

Plausible: the last few volts of the range.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import AT_BEST, NEAR_AT_A_LIMIT, Cause, Context, FloatArray
from piezo_rig.chain.branches import Branches
from piezo_rig.chain.increments import Increment, Operation
from piezo_rig.chain.stage import Parameter, Signal, Stage

NEVER_V = 1000.0  # no piezo amplifier of this kind goes there
SHARES = (0.0001, 0.0002, 0.0004, 0.0008, 0.0013, 0.002, 0.003, 0.0045, 0.0065, 0.009, 0.012, 0.02,
          0.03, 0.05, 0.08, 0.12, 0.17, 0.24, 0.32)  # cut off  # fmt: skip
MORE = (0.0, 0.5, 1.0)  # of what is cut off at one end, cut off besides at the other
WITHIN = 4.0  # times the drive's noise


def _near(context: Context, end: int) -> list[float]:
    """Levels a little within the lowest (0) or highest (1) drive, the nearest first."""
    inwards = context.span_v if end == 0 else -context.span_v
    return [context.ends_v[end] + share * inwards for share in SHARES]


class DriveClipping(Cause):
    """``lower`` and ``upper`` limit; one that nothing reaches stands far away."""

    id = "drive-clipping"
    place = "drive"
    order = -2  # the amplifier's rails and current are within it, its lag is at the load
    together = True
    near: ClassVar[float] = NEAR_AT_A_LIMIT
    known_to: ClassVar[float] = AT_BEST
    whole: ClassVar[bool] = True
    meanings: ClassVar[Mapping[str, str]] = {
        "lower": "the drive never falls below this",
        "upper": "the drive never rises above this",
        "empty_at_v": "where its memory was empty, if not at the lower limit",
    }
    units: ClassVar[Mapping[str, str]] = {"lower": "V", "upper": "V"}
    optional: ClassVar[Mapping[str, str]] = {"empty_at_v": "V"}
    given: ClassVar[tuple[str, ...]] = ("empty_at_v",)
    neutral: ClassVar[Mapping[str, float]] = {"lower": -NEVER_V, "upper": NEVER_V}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {
        "lower": (-1.001 * NEVER_V, NEVER_V), "upper": (-NEVER_V, 1.001 * NEVER_V),
    }
    cuts_off = True  # a flat top
    sharp: ClassVar[Mapping[str, float]] = {"lower": NEVER_V, "upper": NEVER_V}

    def act(self, signal: Signal) -> Signal:
        return signal.with_drive(np.clip(signal.drive_v, self["lower"], self["upper"]))

    def shape(self, branches: Branches) -> Branches:
        risen_v = self["lower"] - self["empty_at_v"] if "empty_at_v" in self.parameters else 0.0
        if risen_v <= 0.0:
            return branches
        return replace(branches, initiation=branches.initiation.beyond(risen_v))

    def otherwise(self) -> list[Stage]:
        """With an actuator that was at 0 V before the amplifier held it above."""
        if "empty_at_v" in self.parameters or not 0.0 < self["lower"] < NEVER_V:
            return []
        return [self.with_values(empty_at_v=0.0)]

    def increment(self, branches: Branches) -> Increment | str:
        return Increment(Operation.CLIP, (self["lower"], self["upper"]))

    @classmethod
    def variants(cls, context: Context) -> list[list[Stage]]:
        return [[cls.of(None, lower=-NEVER_V, upper=v)] for v in _near(context, 1)] + [
            [cls.of(None, lower=v, upper=NEVER_V)] for v in _near(context, 0)
        ]

    def plausible(self, context: Context) -> bool:
        """Where it cuts off more than the noise that the drive was recorded with."""
        low, high = context.ends_v
        return max(self["lower"] - low, high - self["upper"]) > WITHIN * context.noise_v

    def also(self, context: Context) -> list[Stage]:
        """Clipped at the other end as well, and as much or half as much more at this one.

        In closed loops of one size a limit at one end does what is the difference of two.
        """
        this, other = ("upper", "lower") if abs(self["lower"]) >= NEVER_V else ("lower", "upper")
        if abs(self[other]) < NEVER_V:
            return []
        end = int(other == "upper")
        return [
            self.with_values(**{other: v, this: self[this] + share * (context.ends_v[end] - v)})
            for share in MORE for v in _near(context, end)
        ]  # fmt: skip

    def less(self) -> list[Stage]:
        """With the limit at one end only."""
        if max(abs(self["lower"]), abs(self["upper"])) >= NEVER_V:
            return []
        return [self.with_values(lower=-NEVER_V), self.with_values(upper=NEVER_V)]

    @classmethod
    def begun(cls, trials: Sequence[Stage], shares: FloatArray) -> Stage:
        return trials[0]

    def reported(self, covariance: FloatArray) -> dict[str, Parameter]:
        every = super().reported(covariance)
        if abs(self["lower"]) >= NEVER_V:
            every.pop("empty_at_v", None)
        return {n: p for n, p in every.items() if abs(p.value) < NEVER_V}
