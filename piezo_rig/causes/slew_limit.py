"""Slew limit: the amplifier's current bounds how fast the drive can change.

Physics: an amplifier that can deliver a current I charges the capacitance C of the stack at I / C
at most; 150 mA into 1.5 uF are 100 V/ms, small bench amplifiers have a tenth of that and less.

Shows as: nothing at all as long as the command is slower. Beyond, the drive falls behind by more
and more until the command comes back to it: turning points come late and are cut off. Only the
fast conditions show it, and those of a smaller range at the same frequency do not.

Remedy: Play slower, or take an amplifier with more current: faster than the limit it does not
follow.

Plausible: 50 V/s to 100 kV/s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import AT_BEST, NEAR_AT_A_LIMIT, Cause, Context, FloatArray
from piezo_rig.chain.branches import Branches
from piezo_rig.chain.increments import Increment, Operation
from piezo_rig.chain.stage import Signal, Stage

# of the largest slew; just below it, where only the fastest half loop shows
BELOW = 0.98  # of the only speed that is played
SHARES = (0.9995, 0.9985, 0.9965, 0.99, 0.97, 0.94, 0.9, 0.85, 0.78, 0.7, 0.6, 0.5, 0.4, 0.3)
BETWEEN = np.geomspace(0.87, 1.15, 57)  # of the likeliest of those


class SlewLimit(Cause):
    """``limit`` of |dV/dt|."""

    id = "slew-limit"
    place = "drive"
    order = -1  # the amplifier's rails and current are within it, its lag is at the load
    near: ClassVar[float] = NEAR_AT_A_LIMIT
    known_to: ClassVar[float] = AT_BEST
    whole: ClassVar[bool] = True
    law: ClassVar[Mapping[str, float]] = {"time_since_turn": 0.002}
    meanings: ClassVar[Mapping[str, str]] = {
        "limit": "speed that the amplifier does not exceed",
    }
    units: ClassVar[Mapping[str, str]] = {"limit": "V/s"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"limit": (1e-6, 1e12)}
    sharp: ClassVar[Mapping[str, float]] = {"limit": 50.0}
    walked: ClassVar[tuple[str, float]] = ("limit", 1.02)

    def act(self, signal: Signal) -> Signal:
        from piezo_rig.chain.limited import followed

        time, drive = (np.ascontiguousarray(x) for x in (signal.time_s, signal.drive_v))
        return signal.with_drive(followed(time, drive, self["limit"]))

    def increment(self, branches: Branches) -> Increment | str:
        return Increment(Operation.SLEW, (self["limit"],))

    @classmethod
    def variants(cls, context: Context) -> list[list[Stage]]:
        if not context.slews_v_per_s.size:
            return []
        fastest = context.fastest_v_per_s
        return [[cls.of(None, limit=share * fastest)] for share in SHARES]

    def plausible(self, context: Context) -> bool:
        """Where one speed is played, a limit just below it is a delay or a lag by another name; but
        for a first rise from rest, at whose beginning the drive is not late yet.
        """
        return (
            context.several_speeds or context.first_rises
            or self["limit"] < BELOW * context.fastest_v_per_s
        )  # fmt: skip

    @classmethod
    def finer(cls, trials: Sequence[Stage]) -> list[list[Stage]]:
        """Limits between those of the neighbours: past the next half loop's speed it is another."""
        (example,) = trials
        return [[example.with_values(limit=example["limit"] * float(f))] for f in BETWEEN]

    @classmethod
    def begun(cls, trials: Sequence[Stage], shares: FloatArray) -> Stage:
        return trials[0]
