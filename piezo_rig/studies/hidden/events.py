"""What breaks recordings or cuts them off, as its physics says; beside `effects`.

These cannot be had in any size: steps and losses come in whole numbers, and a limit does nothing
until it is reached.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from piezo_rig.studies.hidden import kernels
from piezo_rig.studies.hidden.body import Body
from piezo_rig.studies.hidden.effects import Effect

FloatArray = NDArray[np.float64]
EIGHTH_WAVE_UM = 0.0791
CLEAR = 30  # samples at either end of a recording where nothing happens
FINE = 40  # steps a sample, of what is not solved in closed form


@dataclass(frozen=True, eq=False)
class Event(Effect):
    """Happens ``per_recording`` times in a recording on average, at random."""

    per_recording: float = 0.3

    clock_locked: ClassVar[bool] = True
    least: ClassVar[float] = 1.0
    start: ClassVar[float] = 1.0

    def sized(self, size: float) -> Self:
        return super().sized(float(np.ceil(size)))

    def instants(self, n: int, rng: np.random.Generator) -> list[tuple[int, int]]:
        """(first sample behind it, how much) of every event in a recording of n samples."""
        often = rng.poisson(self.per_recording) if self.size > 0 else 0
        at = np.sort(rng.integers(CLEAR, n - CLEAR, often))
        return [(int(i), self.much(rng)) for i in at]

    def much(self, rng: np.random.Generator) -> int:
        return int(self.size)


class FringeJump(Event):
    """Steps of lambda/8 that stay, of either sign. Size: how many at once."""

    cause: ClassVar[str] = "fringe-jump"
    most: ClassVar[float] = 20.0

    def much(self, rng: np.random.Generator) -> int:
        return int(rng.choice([-1, 1])) * int(self.size)

    def on_clock(self, clock_s: FloatArray, rng: np.random.Generator) -> FloatArray | None:
        out = np.zeros(clock_s.size)
        for index, steps in self.instants(clock_s.size, rng):
            out[index:] += steps * EIGHTH_WAVE_UM
        return out


class DroppedSamples(Event):
    """Samples that are not in the record, which goes on without them. Size: how many at once."""

    cause: ClassVar[str] = "dropped-samples"
    most: ClassVar[float] = 200.0

    def kept(self, n: int, rng: np.random.Generator) -> NDArray[np.int64] | None:
        out = np.arange(n)
        for index, missing in self.instants(n, rng):
            out[index:] += missing
        return out


class SensorClipping(Effect):
    """The sensor's output ends at a level. Size: um by which that lies below 11 um."""

    cause: ClassVar[str] = "sensor-clipping"
    start: ClassVar[float] = 1.0
    most: ClassVar[float] = 9.0

    def parameters(self, body: Body, seconds: float) -> dict[str, float]:
        return {"level": 11.0 - self.size}

    def on_sensor(self, time: FloatArray, drive: FloatArray, x: FloatArray) -> FloatArray:
        return np.minimum(x, 11.0 - self.size)


class DriveClipping(Effect):
    """The amplifier ends below its 75 V. Size: V by which."""

    cause: ClassVar[str] = "drive-clipping"
    start: ClassVar[float] = 0.5
    most: ClassVar[float] = 60.0

    def parameters(self, body: Body, seconds: float) -> dict[str, float]:
        return {"upper": 75.0 - self.size}

    def on_drive(self, time: FloatArray, drive: FloatArray) -> FloatArray:
        return np.minimum(drive, 75.0 - self.size)


class SlewLimit(Effect):
    """The amplifier follows no faster than a limit. Size: its inverse, s/V."""

    cause: ClassVar[str] = "slew-limit"
    start: ClassVar[float] = 1e-3
    most: ClassVar[float] = 0.05

    def parameters(self, body: Body, seconds: float) -> dict[str, float]:
        return {"limit": 1.0 / self.size}

    def on_drive(self, time: FloatArray, drive: FloatArray) -> FloatArray:
        if self.size == 0.0:
            return drive
        return np.asarray(kernels.slowed(time, drive, 1.0 / self.size, FINE))


@dataclass(frozen=True, eq=False)
class ClockRatio(Effect):
    """The digitizer's clock is fast (or slow). Size: ppm."""

    sign: float = 1.0

    cause: ClassVar[str] = "clock-ratio"
    start: ClassVar[float] = 20.0
    most: ClassVar[float] = 1e4

    @classmethod
    def drawn(cls, rng: np.random.Generator, form: str) -> Self:
        return cls(0.0, form, float(rng.choice([-1.0, 1.0])))

    def parameters(self, body: Body, seconds: float) -> dict[str, float]:
        return {"ppm": self.sign * self.size}

    def on_record(self, time: FloatArray, x: FloatArray) -> FloatArray:
        return np.interp(time / (1.0 + 1e-6 * self.sign * self.size), time, x)


EVENTS: dict[str, type[Effect]] = {
    e.cause: e
    for e in (FringeJump, DroppedSamples, SensorClipping, DriveClipping, SlewLimit, ClockRatio)
}
