"""Output bend: the displacement itself is a memoryless, slightly bent function.

Physics: springs and sliders add up to a strain; what the free end does of it need not be linear. A
flexure or a preload that stiffens with travel, a lever's changing angle, a cosine error, a sensor
that is not quite linear: each bends the scale of the displacement, loops and all. It is the output
function of a generalised Prandtl-Ishlinskii model (M. Al Janaideh, S. Rakheja, C.-Y. Su,
Mechatronics 19 (2009) 656).

Shows as: loops that are narrower where the displacement's scale is compressed, and at both of their
branches alike. A bend of the drive (`bend`) lifts the middle of every loop, but leaves its width
alone. Left out of the model it is taken for a law of turning points, or for a direction asymmetry.

Like the bend of the drive it is part of the base model: taken in where the data ask for it, never a
finding, never an alternative of one.

Plausible: 0-5 % of the travel.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import Cause, Context, FloatArray
from piezo_rig.chain.branches import Branches
from piezo_rig.chain.increments import Increment, Operation
from piezo_rig.chain.stage import Signal, Stage

SMALL = 0.002  # of the travel, at its end


class OutputBend(Cause):
    """``x + square x^2 + cube x^3`` of a displacement x in um, from the virgin state."""

    id = "output-bend"
    place = "actuator"
    of_base = True
    together = True
    order = -1
    rate_free = True
    largest: ClassVar[float] = 100.0
    meanings: ClassVar[Mapping[str, str]] = {
        "square": "bend of the displacement, quadratic part",
        "cube": "cubic part of it",
    }
    units: ClassVar[Mapping[str, str]] = {"square": "1/um", "cube": "1/um^2"}

    def act(self, signal: Signal) -> Signal:
        x = signal.displacement_um
        return signal.with_displacement(x + x * x * (self["square"] + self["cube"] * x))

    def carry(self, signal: Signal, changes: FloatArray) -> FloatArray:
        x = signal.displacement_um
        return np.asarray(changes * (1.0 + x * (2.0 * self["square"] + 3.0 * self["cube"] * x)))

    def increment(self, branches: Branches) -> Increment | str:
        return Increment(Operation.BEND_DISPLACEMENT, (self["square"], self["cube"]))

    @classmethod
    def trials(cls, context: Context) -> list[Stage]:
        travel = context.travel_um
        return [
            cls.of(None, square=SMALL / travel, cube=0.0),
            cls.of(None, square=0.0, cube=SMALL / travel**2),
        ]

    def plausible(self, context: Context) -> bool:
        """Whether more of what is bent is still more displacement, as far as the data go."""
        low, high = context.ends_um
        x = np.linspace(low, high, 101)
        slope = 1.0 + x * (2.0 * self["square"] + 3.0 * self["cube"] * x)
        return bool(np.all(slope > 0.0))
