"""Input bend: springs and sliders do not follow the drive, but a slightly bent function of it.

Physics: what moves the domain walls is the field and the strain that it makes; both grow a little
faster or slower than the voltage (electrostriction, a permittivity that depends on the field). It
is the envelope, or input function, of a generalised Prandtl-Ishlinskii model (M. Al Janaideh, S.
Rakheja, C.-Y. Su, Mechatronics 19 (2009) 656). The ends of the drive stay where they are: a factor
would be the elements' own.

Shows as: elements that give way earlier after a turning point at one end of the drive than at the
other. A bend of the strain (`bend`) lifts the middle of every loop, but moves no threshold. Left
out of the model it is taken for a direction asymmetry or a law of turning points.

Like that bend it is part of the base model: taken in where the data ask for it, never a finding,
never an alternative of one.

Plausible: 0-5 % of the drive's range in its middle.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import Cause, Context, FloatArray
from piezo_rig.chain.branches import Branches
from piezo_rig.chain.increments import Increment, Operation
from piezo_rig.chain.stage import Signal, Stage

SMALL = 0.004  # of the drive's range
LARGE = (-0.15, -0.05, 0.05, 0.15)  # in the middle a quarter of it


class InputBend(Cause):
    """``v + u (u - 1) (square + cube u)``, u = (v - from_v) / over_v, of a drive v."""

    id = "input-bend"
    place = "drive"
    order = 1
    of_base = True
    together = True
    rate_free = True
    near: ClassVar[float] = 0.05
    largest: ClassVar[float] = 100.0
    meanings: ClassVar[Mapping[str, str]] = {
        "square": "bend of the drive before springs and sliders, quadratic part",
        "cube": "cubic part of it",
        "from_v": "where the bend begins",
        "over_v": "drives over which it is counted",
    }
    units: ClassVar[Mapping[str, str]] = {"square": "V", "cube": "V"}
    optional: ClassVar[Mapping[str, str]] = {"from_v": "V", "over_v": "V"}
    given: ClassVar[tuple[str, ...]] = ("from_v", "over_v")
    neutral: ClassVar[Mapping[str, float]] = {"over_v": 1.0}

    def act(self, signal: Signal) -> Signal:
        u = (signal.drive_v - self["from_v"]) / self["over_v"]
        return signal.with_drive(signal.drive_v + self._added(u))

    def _added(self, u: FloatArray) -> FloatArray:
        return np.asarray(u * (u - 1.0) * (self["square"] + self["cube"] * u))

    def increment(self, branches: Branches) -> Increment | str:
        numbers = tuple(self[n] for n in ("from_v", "over_v", "square", "cube"))
        return Increment(Operation.BEND_DRIVE, numbers)

    @classmethod
    def trials(cls, context: Context) -> list[Stage]:
        low, high = context.ends_v
        if not high > low:
            return []
        nothing = {"square": 0.0, "cube": 0.0, "from_v": low, "over_v": high - low}
        return [cls.of(None, **nothing | {name: SMALL * (high - low)}) for name in cls.units]

    def at_large(self, near: Stage | None = None) -> list[Stage]:
        """Bent by 1 to 4 % of the range: in coloured noise no descent from none ends there."""
        if near is not None:
            return [near.with_values(square=f * near["square"]) for f in (0.75, 1.3)]
        return [self.with_values(square=f * self["over_v"], cube=0.0) for f in LARGE]

    def plausible(self, context: Context) -> bool:
        """Whether more drive is more of what it is bent to, everywhere between its ends."""
        u = np.linspace(0.0, 1.0, 101)
        return bool(np.all(np.diff(self["over_v"] * u + self._added(u)) > 0.0))
