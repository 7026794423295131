"""Drive gain: the amplifier's gain is not the one on its label.

Physics: the drive is gain x command + offset; a gain that was never calibrated, or a supply that
has aged, makes every excursion of the drive larger or smaller than it is taken to be. What is
multiplied is the command, so that the drive stays right where the command is 0 V: at the
amplifier's offset, or at 0 V where all of the drive is off. Between the two springs and sliders
make no difference, their memory begins where the drive begins; a memoryless bend does.

Shows as: turning points and thresholds that lie elsewhere along the drive, so that a larger gain
runs further into the steep part of every branch. A model that is refitted takes its own
thresholds along and hides it completely; only a model of the same actuator that is held fixed
can show it. The displacement grows too, nearly as with a wrong sensitivity; what tells the two
apart is where, after a turning point, the elements give way.

Remedy: Measure the drive with a voltmeter and run `calibrate`; put the new gain into the rig's
config.

Plausible: 0.1-5 %; a factor where the amplifier's range was set wrongly.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from piezo_rig.causes.cause import Cause, Context
from piezo_rig.chain.branches import Branches
from piezo_rig.chain.increments import Increment, Operation
from piezo_rig.chain.stage import Signal, Stage


class DriveGain(Cause):
    """``ratio`` of the true gain to the nominal one."""

    id = "drive-gain"
    place = "drive"
    order = -3
    together = True
    needs_fixed_model = True
    meanings: ClassVar[Mapping[str, str]] = {
        "ratio": "gain of the amplifier over the one that is assumed",
        "stays_v": "the drive at which it makes no difference",
    }
    units: ClassVar[Mapping[str, str]] = {"ratio": "1"}
    optional: ClassVar[Mapping[str, str]] = {"stays_v": "V"}  # the drive that stays right
    given: ClassVar[tuple[str, ...]] = ("stays_v",)
    neutral: ClassVar[Mapping[str, float]] = {"ratio": 1.0, "stays_v": 0.0}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"ratio": (0.2, 5.0)}

    def act(self, signal: Signal) -> Signal:
        return signal.with_drive(self["ratio"] * signal.drive_v + self.added_v)

    @property
    def added_v(self) -> float:
        """What is added to the multiplied drive, V."""
        stays = self["stays_v"] if "stays_v" in self.parameters else 0.0
        return (1.0 - self["ratio"]) * stays

    def increment(self, branches: Branches) -> Increment | str:
        return Increment(Operation.GAIN, (self["ratio"], self.added_v))

    @classmethod
    def trials(cls, context: Context) -> list[Stage]:
        return [cls.of(None, ratio=1.002)]

    @classmethod
    def variants(cls, context: Context) -> list[list[Stage]]:
        offset = cls.of(None, ratio=1.002, stays_v=context.offset_v)
        return [cls.trials(context), *([[offset]] if context.offset_v else [])]
