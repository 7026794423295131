"""What is written on the instruments is not so: gain and sensitivity.

A model that is refitted to the recordings shows neither. They are hidden for a diagnosis against
a model that was identified before, see `Case.before`; their size is not searched for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from piezo_rig.studies.hidden.body import FULL_V, Body
from piezo_rig.studies.hidden.effects import Effect

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Miscalibrated(Effect):
    """Size: \\|ratio - 1\\|."""

    sign: float = 1.0

    forms: ClassVar[tuple[str, ...]] = ("A", "B")
    start: ClassVar[float] = 0.01
    least: ClassVar[float] = 0.01
    most: ClassVar[float] = 0.01

    @classmethod
    def drawn(cls, rng: np.random.Generator, form: str) -> Self:
        return cls(0.0, form, float(rng.choice([-1.0, 1.0])))

    def parameters(self, body: Body, seconds: float) -> dict[str, float]:
        return {"ratio": self.ratio}

    @property
    def ratio(self) -> float:
        return 1.0 + self.sign * self.size


class DriveGain(Miscalibrated):
    """A: the whole drive is off. B: the command's share is, and 75 V stay 75 V."""

    cause: ClassVar[str] = "drive-gain"

    def on_drive(self, time: FloatArray, drive: FloatArray) -> FloatArray:
        stays = FULL_V if self.form == "B" else 0.0
        return stays + self.ratio * (drive - stays)


class SensorScale(Miscalibrated):
    """A: the sensitivity is off. B: and it falls off a little with the displacement, as that of a
    beam that leaves its detector: by a hundredth of what it is off at 10 um."""

    cause: ClassVar[str] = "sensor-scale"
    fall: ClassVar[float] = 0.01

    def parameters(self, body: Body, seconds: float) -> dict[str, float]:
        return super().parameters(body, seconds) if self.form == "A" else {}

    def on_sensor(self, time: FloatArray, drive: FloatArray, x: FloatArray) -> FloatArray:
        if self.form == "A":
            return x / self.ratio
        return x / self.ratio * (1.0 - self.fall * self.size * x / 10.0)


CALIBRATION: dict[str, type[Effect]] = {e.cause: e for e in (DriveGain, SensorScale)}
