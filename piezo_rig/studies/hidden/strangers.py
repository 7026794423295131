"""Effects that are in no catalogue: a diagnosis should say "unexplained", not a name."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from piezo_rig.studies.hidden import kernels
from piezo_rig.studies.hidden.effects import Effect

FloatArray = NDArray[np.float64]


def _turns(drive: FloatArray) -> NDArray[np.int64]:
    """Samples at which the drive reverses, the first sample included."""
    way = np.sign(np.diff(drive))
    moving = np.flatnonzero(way)
    changed = moving[1:][np.diff(way[moving]) != 0]
    return np.append(0, changed).astype(np.int64)


@dataclass(frozen=True, eq=False)
class Stranger(Effect):
    """``where`` and ``width`` mean something else to each of them."""

    where: float = 0.5
    width: float = 0.1
    phase: float = 0.0

    most: ClassVar[float] = 0.5
    start: ClassVar[float] = 5e-3

    @classmethod
    def drawn(cls, rng: np.random.Generator, form: str) -> Self:
        return cls(0.0, form, float(rng.uniform(0.25, 0.65)), float(rng.uniform(0.0, 1.0)))


class Stick(Stranger):
    """A guide that sticks near one displacement, against the motion in either direction; um."""

    cause: ClassVar[str] = "stranger:stick"

    def on_actuator(self, time: FloatArray, drive: FloatArray, x: FloatArray) -> FloatArray:
        reach = 3.0 + 4.0 * self.where  # um
        way = np.sign(np.gradient(drive, time))
        behind = kernels.first_order(time, way, 2e-3)
        near = np.exp(-0.5 * ((np.abs(x) - 0.8 * reach) / (0.3 + 0.4 * self.width)) ** 2)
        return x - self.size * behind * near


class Backlash(Stranger):
    """A contact that snaps over at one drive and back at a lower one; um."""

    cause: ClassVar[str] = "stranger:backlash"

    def on_actuator(self, time: FloatArray, drive: FloatArray, x: FloatArray) -> FloatArray:
        top = 50.0 * self.where
        state = kernels.relayed(np.ascontiguousarray(drive), top - 1.0 - 5.0 * self.width, top)
        return x + self.size * state


class Subharmonic(Stranger):
    """Every second cycle differs; um at the largest drive of the recording."""

    cause: ClassVar[str] = "stranger:subharmonic"

    def on_actuator(self, time: FloatArray, drive: FloatArray, x: FloatArray) -> FloatArray:
        starts = _turns(drive)
        half = np.searchsorted(starts, np.arange(drive.size), side="right") - 1
        odd = (half // 2) % 2
        low, high = float(drive.min()), float(drive.max())
        u = (drive - low) / (high - low)
        arch = u * (1.0 - u) * (1.0 + 2.0 * self.width * u)
        return x + 4.0 * self.size * odd * arch


class Stiffening(Stranger):
    """A stop that is touched above some displacement; um lost a micrometre further in."""

    cause: ClassVar[str] = "stranger:stiffening"

    def on_actuator(self, time: FloatArray, drive: FloatArray, x: FloatArray) -> FloatArray:
        begin = 1.5 + 6.0 * self.where
        if np.ptp(x) < begin:
            begin = self.where * float(np.ptp(x))
        return x - self.size * np.maximum(x - begin, 0.0)


@dataclass(frozen=True, eq=False)
class Seismic(Stranger):
    """A line at 37 Hz from the floor, in clock time; um."""

    cause: ClassVar[str] = "stranger:seismic"
    clock_locked: ClassVar[bool] = True

    def session(self, rng: np.random.Generator) -> Self:
        return replace(self, phase=float(rng.uniform(0.0, 2.0 * np.pi)))

    def on_clock(self, clock_s: FloatArray, rng: np.random.Generator) -> FloatArray | None:
        return self.size * np.sin(2.0 * np.pi * (37.0 + self.width) * clock_s + self.phase)


class Slip(Stranger):
    """The mount slips once a recording, after a certain travel; um."""

    cause: ClassVar[str] = "stranger:slip"

    def on_sensor(self, time: FloatArray, drive: FloatArray, x: FloatArray) -> FloatArray:
        travel = np.append(0.0, np.cumsum(np.abs(np.diff(x))))
        after = travel > (0.5 + self.where) * 20.0
        return x - self.size * after


class GainAfterTurn(Stranger):
    """Motion right after a turning point is read with another gain, for 20-80 ms; its share."""

    cause: ClassVar[str] = "stranger:gain-after-turn"

    def on_sensor(self, time: FloatArray, drive: FloatArray, x: FloatArray) -> FloatArray:
        starts = _turns(drive)
        since = time - time[starts[np.searchsorted(starts, np.arange(x.size), side="right") - 1]]
        extra = np.exp(-since / (0.02 + 0.06 * self.width))
        return x + self.size * np.append(0.0, np.cumsum(extra[1:] * np.diff(x)))


class TravelGain(Stranger):
    """The gain warms up with the travel done, saturating; its share."""

    cause: ClassVar[str] = "stranger:travel-gain"

    def on_sensor(self, time: FloatArray, drive: FloatArray, x: FloatArray) -> FloatArray:
        travel = np.append(0.0, np.cumsum(np.abs(np.diff(x))))
        return x * (1.0 + self.size * -np.expm1(-travel / (10.0 + 40.0 * self.where)))


class DriveRipple(Stranger):
    """A converter's error that is periodic in the drive; um."""

    cause: ClassVar[str] = "stranger:drive-ripple"

    def on_actuator(self, time: FloatArray, drive: FloatArray, x: FloatArray) -> FloatArray:
        period = 3.0 + 5.0 * self.width
        return x + self.size * (np.sin(2.0 * np.pi * (drive / period + self.where)))


STRANGERS: dict[str, type[Stranger]] = {
    s.cause: s
    for s in (Stick, Backlash, Subharmonic, Stiffening, Seismic, Slip, GainAfterTurn, TravelGain,
              DriveRipple)
}  # fmt: skip
