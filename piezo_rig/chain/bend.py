"""A memoryless bend of the actuator: its reversible strain is not quite linear in the drive.

Springs and sliders follow the drive with a fixed mean slope; electrostriction and the field
dependence of the permittivity add a polynomial without memory (D. Damjanovic, Rep. Prog. Phys.
61 (1998) 1267). It belongs to the base model of a diagnosis where data ask for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain.branches import Branches
from piezo_rig.chain.increments import Increment, Operation
from piezo_rig.chain.stage import Signal, Stage

FloatArray = NDArray[np.float64]
POWERS = {"square": 2, "cube": 3, "fourth": 4, "fifth": 5}
NAMES = {power: name for name, power in POWERS.items()}
LOOKED_AT = (0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0)  # of the span


class Bend(Stage):
    """Polynomial of u = (drive - from_v) / over_v, coefficients in um."""

    id = "bend"
    place = "actuator"
    units: ClassVar[Mapping[str, str]] = {
        "from_v": "V", "over_v": "V", **dict.fromkeys(POWERS, "um"),
    }
    rate_free = True
    together = True
    linear: ClassVar[tuple[str, ...]] = tuple(POWERS)

    @property
    def passes(self) -> bool:
        """Small changes of the displacement do not change what is added to it."""
        return True

    @classmethod
    def none(cls, from_v: float, over_v: float) -> Stage:
        """A bend of nothing, to begin with."""
        return cls.of(None, from_v=from_v, over_v=over_v, **dict.fromkeys(POWERS, 0.0))

    @staticmethod
    def curvature() -> FloatArray:
        """Second derivatives by u of all terms at `LOOKED_AT`, their coefficients 1; (k, 4)."""
        return np.array([[n * (n - 1.0) * u ** (n - 2) for n in NAMES] for u in LOOKED_AT])

    def act(self, signal: Signal) -> Signal:
        numbers = tuple(self[name] for name in self.units)
        bent = signal.of_drive.get((self.id, *numbers), lambda: self._bent(signal.drive_v))
        return signal.with_displacement(signal.displacement_um + bent)

    def _bent(self, drive_v: FloatArray) -> FloatArray:
        u = (drive_v - self["from_v"]) / self["over_v"]
        bent = np.zeros_like(u)
        for power in range(max(POWERS.values()), 0, -1):
            bent += self[NAMES[power]] if power in NAMES else 0.0
            bent *= u
        return bent

    def increment(self, branches: Branches) -> Increment | str:
        numbers = (self["from_v"], self["over_v"], *(self[name] for name in POWERS))
        return Increment(Operation.BEND, numbers)
