"""Amplifier lag: the drive follows the command behind a first-order lag.

Physics: the amplifier's output resistance (or its current limit at small signals) charges the
capacitance of the stack; tau = R C, with 1.5 uF and 10-100 ohm. Shown with the drive taken as
commanded; where a drive monitor was recorded the lag is read from it, or ruled out by it. A lag
of less than a third of a sampling step looks like a delay there as well.

Shows as: loops that open in proportion to the speed of the drive, and rounded corners. Against a
plain delay it differs only in the corners, within a few tau of them.

Remedy: An amplifier with more current, or slower drives; `compensate` leads the drive by it.
Nothing is wrong with the stack.

Plausible: 15-150 us; milliseconds for slow amplifiers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import NEAR_IN_TIME, Cause, Context
from piezo_rig.chain.branches import Branches
from piezo_rig.chain.increments import Increment, Operation
from piezo_rig.chain.stage import Signal, Stage


class AmplifierLag(Cause):
    """``tau`` of the first-order lag."""

    id = "amplifier-lag"
    place = "drive"
    together = True
    of_speed = True
    lasting: ClassVar[str] = "tau"
    law: ClassVar[Mapping[str, float]] = {"time_since_turn": 0.002}
    near: ClassVar[float] = NEAR_IN_TIME
    meanings: ClassVar[Mapping[str, str]] = {
        "tau": "time constant of the amplifier with the stack as its load",
    }
    units: ClassVar[Mapping[str, str]] = {"tau": "s"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"tau": (0.0, 10.0)}

    def act(self, signal: Signal) -> Signal:
        tau = self["tau"]
        if tau <= 0.0:
            return signal
        from piezo_rig.chain.relaxation import off_each

        time, drive = (np.ascontiguousarray(x) for x in (signal.time_s, signal.drive_v))
        return signal.with_drive(drive + off_each(signal.begins, time, drive, tau))

    def increment(self, branches: Branches) -> Increment | str:
        tau = self["tau"]
        if tau > 0.0:
            return Increment(Operation.LAG, (tau,))
        return Increment(Operation.GAIN, (1.0, 0.0))

    @classmethod
    def trials(cls, context: Context) -> list[Stage]:
        return [cls.of(None, tau=max(2e-5, 0.1 * context.step_s))]
