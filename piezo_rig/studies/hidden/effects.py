"""What can be hidden, written out as its physics says; one class per effect of the catalogue.

An effect acts at its place of the chain. ``size`` is the one number that scales it, in the unit
that its class says; everything else is drawn once. ``parameters`` are in the catalogue's terms
and hold only what the form of the effect defines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from piezo_rig.studies.hidden import kernels
from piezo_rig.studies.hidden.body import FULL_V, Body, Law

FloatArray = NDArray[np.float64]
HALF_WAVE_UM = 0.3164


@dataclass(frozen=True, eq=False)
class Effect:
    """One hidden effect.

    Attributes
    ----------
    size : in the unit of the class
    form : which of its forms, where it has several
    """

    size: float = 0.0
    form: str = "A"

    cause: ClassVar[str] = ""
    start: ClassVar[float] = 1e-3  # a size to begin a search with
    most: ClassVar[float] = 1.0  # the largest plausible size
    least: ClassVar[float] = 0.0  # smaller is not worth its name, however many there are
    forms: ClassVar[tuple[str, ...]] = ("A",)
    clock_locked: ClassVar[bool] = False
    first_element: ClassVar[bool] = False  # needs a body with a distinct first element
    places: ClassVar[str] = ""  # a place that two effects cannot share

    @classmethod
    def drawn(cls, rng: np.random.Generator, form: str) -> Self:
        """With random constants, of size 0."""
        return cls(form=form)

    def sized(self, size: float) -> Self:
        return replace(self, size=size)

    def session(self, rng: np.random.Generator) -> Self:
        """With what a new session draws anew."""
        return self

    def parameters(self, body: Body, seconds: float) -> dict[str, float]:
        """In the catalogue's terms; ``seconds`` recorded in all."""
        return {}

    def on_drive(self, time: FloatArray, drive: FloatArray) -> FloatArray:
        return drive

    def on_body(
        self, body: Body, time: FloatArray, drive: FloatArray, base: FloatArray
    ) -> FloatArray | None:
        """Displacement (n,) in the place of the body's own, or None."""
        return None

    def on_actuator(self, time: FloatArray, drive: FloatArray, x: FloatArray) -> FloatArray:
        return x

    def on_sensor(self, time: FloatArray, drive: FloatArray, x: FloatArray) -> FloatArray:
        return x

    def on_record(self, time: FloatArray, x: FloatArray) -> FloatArray:
        return x

    def on_clock(self, clock_s: FloatArray, rng: np.random.Generator) -> FloatArray | None:
        """What the sensor adds at these seconds of the session, um, or None."""
        return None

    def placed(self, body: Body, drives: Sequence[FloatArray]) -> Self:
        """With the actuator, and the drives of all recordings in the order of the session."""
        return self

    def on_recording(self, recording: int) -> FloatArray | None:
        """What one recording of the session has that another of its condition has not, um."""
        return None

    def kept(self, n: int, rng: np.random.Generator) -> NDArray[np.int64] | None:
        """Which samples of the digitizer's clock make a recording of n, or None for all."""
        return None


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


@dataclass(frozen=True, eq=False)
class InitiationStage(Effect):
    """A: the first rise has its own elements. B: strain that the largest \\|drive\\| sets for good.

    Size: A, relative change of the compliance of the first rise; B, um at 75 V.
    """

    sign: float = 1.0
    shape: tuple[float, float, float] = (1.0, 0.0, 0.0)
    knots: tuple[float, ...] = ()
    half_v: float = 30.0

    cause: ClassVar[str] = "initiation-stage"
    forms: ClassVar[tuple[str, ...]] = ("A", "B")
    start: ClassVar[float] = 0.01
    most: ClassVar[float] = 0.8

    @classmethod
    def drawn(cls, rng: np.random.Generator, form: str) -> Self:
        shape = tuple(rng.uniform(-0.5, 0.5, 3) + np.array([1.0, 0.0, 0.0]))
        knots = tuple(np.sort(rng.uniform(0.3, FULL_V, int(rng.integers(25, 60)))))
        return cls(0.0, form, _sign(rng), shape, knots, float(rng.uniform(15.0, 60.0)))

    def on_body(
        self, body: Body, time: FloatArray, drive: FloatArray, base: FloatArray
    ) -> FloatArray | None:
        if self.form == "B":
            return None
        knots, values, last = body.rise()
        own = np.unique(np.concatenate([knots, self.knots, [1.2 * FULL_V]]))
        before = np.where(own > knots[-1], values[-1] + (own - knots[-1]) * last,
                          np.interp(own, knots, values))  # fmt: skip
        edges = np.concatenate([[0.0], self.knots, [1.5 * FULL_V]])
        band = np.searchsorted(edges, 0.5 * (own[1:] + own[:-1])) - 1
        u = 0.5 * (edges[1:] + edges[:-1])[band] / FULL_V
        factor = 1.0 + self.sign * self.size * np.polynomial.polynomial.polyval(u, self.shape)
        steps = np.diff(before) * np.clip(factor, 0.05, None)
        rise = (own, np.append(0.0, np.cumsum(steps)), float(steps[-1] / (own[-1] - own[-2])))
        return body.displacement(drive, rise=rise)

    def on_actuator(self, time: FloatArray, drive: FloatArray, x: FloatArray) -> FloatArray:
        if self.form == "A":
            return x
        largest = np.maximum.accumulate(np.abs(drive))
        grown = (1.0 - np.exp(-largest / self.half_v)) / (1.0 - np.exp(-FULL_V / self.half_v))
        way = np.sign(drive[np.argmax(np.abs(drive))])
        return x + self.sign * self.size * way * grown


@dataclass(frozen=True, eq=False)
class RangeDependence(Effect):
    """A: thesis eq. 7-8, k_1 = slope x range + offset, its dx unchanged; the first rise has a
    range of 0 behind it. B: the initial compliance changes in proportion to the range and dies
    out smoothly over 2-6 V.

    Size: A, \\|slope\\| V/um per V. B, um/V at a range of 75 V.
    """

    sign: float = 1.0
    reach_v: float = 4.0

    cause: ClassVar[str] = "range-dependence"
    forms: ClassVar[tuple[str, ...]] = ("A", "B")
    start: ClassVar[float] = 1e-3
    most: ClassVar[float] = 0.05
    first_element: ClassVar[bool] = True
    places: ClassVar[str] = "first spring"

    @classmethod
    def drawn(cls, rng: np.random.Generator, form: str) -> Self:
        sign = 1.0 if form == "A" else -1.0  # a larger range, a stiffer beginning
        return cls(0.0, form, sign, float(rng.uniform(2.0, 6.0)))

    def parameters(self, body: Body, seconds: float) -> dict[str, float]:
        if self.form == "B":
            return {}
        return {"slope": self.sign * self.size, "offset": body.first_spring}

    def on_body(
        self, body: Body, time: FloatArray, drive: FloatArray, base: FloatArray
    ) -> FloatArray | None:
        if self.form == "A":
            return body.displacement(drive, Law(per_range=self.sign * self.size))
        bump = self.sign * self.size / FULL_V
        return body.displacement(drive, Law(bump_per_range=bump, reach=self.reach_v))


@dataclass(frozen=True, eq=False)
class ExtremumDependence(Effect):
    """Thesis eq. 9-10: k_1 = slope x drive at the turning point + offset, its dx unchanged.

    Size: slope, V/um per V.
    """

    cause: ClassVar[str] = "extremum-dependence"
    most: ClassVar[float] = 0.05
    first_element: ClassVar[bool] = True
    places: ClassVar[str] = "first spring"

    def parameters(self, body: Body, seconds: float) -> dict[str, float]:
        return {"slope": self.size, "offset": body.first_spring}

    def on_body(
        self, body: Body, time: FloatArray, drive: FloatArray, base: FloatArray
    ) -> FloatArray | None:
        return body.displacement(drive, Law(per_extremum=self.size))


@dataclass(frozen=True, eq=False)
class DirectionAsymmetry(Effect):
    """A: first slopes (to the first element's break) in a ratio, rising over falling. B: a smooth
    extra compliance after the turning point, of opposite sign in the two directions.

    Size: A, ratio - 1. B, um/V.
    """

    sign: float = 1.0
    reach_v: float = 4.0

    cause: ClassVar[str] = "direction-asymmetry"
    forms: ClassVar[tuple[str, ...]] = ("A", "B")
    most: ClassVar[float] = 0.4
    first_element: ClassVar[bool] = True
    places: ClassVar[str] = "first spring"

    @classmethod
    def drawn(cls, rng: np.random.Generator, form: str) -> Self:
        return cls(0.0, form, _sign(rng), float(rng.uniform(2.0, 6.0)))

    def parameters(self, body: Body, seconds: float) -> dict[str, float]:
        return {"ratio": 1.0 + self.sign * self.size} if self.form == "A" else {}

    def on_body(
        self, body: Body, time: FloatArray, drive: FloatArray, base: FloatArray
    ) -> FloatArray | None:
        if self.form == "A":
            return body.displacement(drive, Law(ratio=1.0 + self.sign * self.size))
        bump = 0.05 * self.sign * self.size
        return body.displacement(drive, Law(bump_direction=bump, reach=self.reach_v))


PER_DECADE = 8


@dataclass(frozen=True, eq=False)
class Creep(Effect):
    """A: logarithmic creep, relaxations from 10 ms to 1000 s, eight a decade. B: three of them.

    Size: A, share of the displacement change per decade. B, mean share of a relaxation.
    """

    times_s: tuple[float, ...] = ()
    shares: tuple[float, ...] = ()

    cause: ClassVar[str] = "creep"
    forms: ClassVar[tuple[str, ...]] = ("A", "B")
    most: ClassVar[float] = 0.05

    @classmethod
    def drawn(cls, rng: np.random.Generator, form: str) -> Self:
        if form == "A":
            times = 10.0 ** (-2.0 + (np.arange(5 * PER_DECADE) + 0.5) / PER_DECADE)
            return cls(0.0, form, tuple(times), (1.0 / PER_DECADE,) * times.size)
        times = np.exp(rng.uniform(np.log([0.03, 0.3, 3.0]), np.log([0.3, 3.0, 60.0])))
        return cls(0.0, form, tuple(times), tuple(rng.uniform(0.5, 1.5, 3)))

    def parameters(self, body: Body, seconds: float) -> dict[str, float]:
        return {"rate_per_decade": self.size} if self.form == "A" else {}

    def on_actuator(self, time: FloatArray, drive: FloatArray, x: FloatArray) -> FloatArray:
        return x + self.size * kernels.relaxing(
            time, np.ascontiguousarray(x), np.array(self.times_s), np.array(self.shares)
        )


@dataclass(frozen=True, eq=False)
class RateDependence(Effect):
    """A: the displacement lags by lag (\\|dV/dt\\| / 300)^exponent, the rate taken over 3 ms.
    B: thresholds grow with the rate (Al Janaideh and Krejci 2013).

    Size: A, lag in um at 300 V/s. B, V at 300 V/s.
    """

    exponent: float = 0.7

    cause: ClassVar[str] = "rate-dependence"
    forms: ClassVar[tuple[str, ...]] = ("A", "B")
    start: ClassVar[float] = 0.01
    most: ClassVar[float] = 3.0

    @classmethod
    def drawn(cls, rng: np.random.Generator, form: str) -> Self:
        return cls(0.0, form, float(rng.uniform(0.4, 1.0)))

    def parameters(self, body: Body, seconds: float) -> dict[str, float]:
        return {"lag_um": self.size, "exponent": self.exponent} if self.form == "A" else {}

    def _rate(self, time: FloatArray, drive: FloatArray) -> FloatArray:
        """dV/dt in units of 300 V/s, over 3 ms."""
        behind = kernels.first_order(time, np.ascontiguousarray(drive), 3e-3)
        return (drive - behind) / 3e-3 / 300.0

    def on_body(
        self, body: Body, time: FloatArray, drive: FloatArray, base: FloatArray
    ) -> FloatArray | None:
        if self.form == "A":
            return None
        wider = self.size * np.abs(self._rate(time, drive)) ** self.exponent
        return body.rate_dependent(drive, wider)

    def on_actuator(self, time: FloatArray, drive: FloatArray, x: FloatArray) -> FloatArray:
        if self.form == "B":
            return x
        rate = self._rate(time, drive)
        return x - self.size * np.sign(rate) * np.abs(rate) ** self.exponent


@dataclass(frozen=True, eq=False)
class AmplifierLag(Effect):
    """A first-order lag of the drive, exact where the command is straight. Size: tau, s."""

    cause: ClassVar[str] = "amplifier-lag"
    start: ClassVar[float] = 5e-5
    most: ClassVar[float] = 5e-3

    def parameters(self, body: Body, seconds: float) -> dict[str, float]:
        return {"tau": self.size}

    def on_drive(self, time: FloatArray, drive: FloatArray) -> FloatArray:
        if self.size == 0.0:
            return drive
        return kernels.first_order(time, np.ascontiguousarray(drive), self.size)


@dataclass(frozen=True, eq=False)
class TimeSkew(Effect):
    """The record is late. Size: delay, s."""

    cause: ClassVar[str] = "time-skew"
    start: ClassVar[float] = 5e-5
    most: ClassVar[float] = 5e-3

    def parameters(self, body: Body, seconds: float) -> dict[str, float]:
        return {"delay": self.size}

    def on_record(self, time: FloatArray, x: FloatArray) -> FloatArray:
        return np.interp(time - self.size, time, x)


@dataclass(frozen=True, eq=False)
class ThermalDrift(Effect):
    """A: a straight line through the whole session. B: warming up, exponential.

    Size: nm/s; B, at the beginning.
    """

    sign: float = 1.0
    tau_s: float = 300.0

    cause: ClassVar[str] = "thermal-drift"
    forms: ClassVar[tuple[str, ...]] = ("A", "B")
    start: ClassVar[float] = 1.0
    most: ClassVar[float] = 100.0
    clock_locked: ClassVar[bool] = True

    @classmethod
    def drawn(cls, rng: np.random.Generator, form: str) -> Self:
        return cls(0.0, form, _sign(rng), float(np.exp(rng.uniform(np.log(200), np.log(2000)))))

    def parameters(self, body: Body, seconds: float) -> dict[str, float]:
        return {"rate": self.sign * self.size} if self.form == "A" else {}

    def on_clock(self, clock_s: FloatArray, rng: np.random.Generator) -> FloatArray | None:
        rate = 1e-3 * self.sign * self.size
        if self.form == "A":
            return rate * clock_s
        return -rate * self.tau_s * np.expm1(-clock_s / self.tau_s)


@dataclass(frozen=True, eq=False)
class MainsHum(Effect):
    """50 or 60 Hz within 0.05 Hz and its third harmonic; phases anew in every session.

    Size: peak amplitude of the fundamental, nm.
    """

    hz: float = 50.0
    third: float = 0.2
    phases: tuple[float, float] = (0.0, 0.0)

    cause: ClassVar[str] = "mains-hum"
    start: ClassVar[float] = 1.0
    most: ClassVar[float] = 50.0
    clock_locked: ClassVar[bool] = True

    @classmethod
    def drawn(cls, rng: np.random.Generator, form: str) -> Self:
        hz = float(rng.choice([50.0, 60.0]) + rng.uniform(-0.05, 0.05))
        return cls(0.0, form, hz, float(rng.uniform(0.1, 0.5)))

    def session(self, rng: np.random.Generator) -> Self:
        phases = rng.uniform(0.0, 2.0 * np.pi, 2)
        return replace(self, phases=(float(phases[0]), float(phases[1])))

    def parameters(self, body: Body, seconds: float) -> dict[str, float]:
        return {"frequency": self.hz, "amplitude": self.size}

    def on_clock(self, clock_s: FloatArray, rng: np.random.Generator) -> FloatArray | None:
        angle = 2.0 * np.pi * self.hz * clock_s
        wave = np.sin(angle + self.phases[0])
        return 1e-3 * self.size * (wave + self.third * np.sin(3.0 * angle + self.phases[1]))


@dataclass(frozen=True, eq=False)
class PeriodicNonlinearity(Effect):
    """Interferometer error over displacement, first order and a weaker second.

    Size: peak amplitude of the first order, nm.
    """

    phases: tuple[float, float] = (0.0, 0.0)
    second: float = 0.2

    cause: ClassVar[str] = "periodic-nonlinearity"
    start: ClassVar[float] = 0.5
    most: ClassVar[float] = 20.0

    @classmethod
    def drawn(cls, rng: np.random.Generator, form: str) -> Self:
        phases = rng.uniform(0.0, 2.0 * np.pi, 2)
        return cls(0.0, form, (float(phases[0]), float(phases[1])), float(rng.uniform(0.0, 0.4)))

    def parameters(self, body: Body, seconds: float) -> dict[str, float]:
        return {"amplitude": self.size}

    def on_sensor(self, time: FloatArray, drive: FloatArray, x: FloatArray) -> FloatArray:
        angle = 2.0 * np.pi / HALF_WAVE_UM * x
        ripple = np.sin(angle + self.phases[0]) + self.second * np.sin(2 * angle + self.phases[1])
        return x + 1e-3 * self.size * ripple


@dataclass(frozen=True, eq=False)
class Outliers(Effect):
    """Isolated spikes of 1-3 samples, of random sign and size. Size: mean height, um."""

    per_second: float = 1.0

    cause: ClassVar[str] = "outliers"
    start: ClassVar[float] = 0.05
    most: ClassVar[float] = 2.0
    least: ClassVar[float] = 0.03
    clock_locked: ClassVar[bool] = True

    @classmethod
    def drawn(cls, rng: np.random.Generator, form: str) -> Self:
        return cls(0.0, form, float(np.exp(rng.uniform(np.log(0.5), np.log(5.0)))))

    def parameters(self, body: Body, seconds: float) -> dict[str, float]:
        return {"per_second": self.per_second}

    def on_clock(self, clock_s: FloatArray, rng: np.random.Generator) -> FloatArray | None:
        out = np.zeros(clock_s.size)
        seconds = float(clock_s[-1] - clock_s[0])
        for _ in range(rng.poisson(self.per_second * seconds)):
            at, width = int(rng.integers(3, clock_s.size - 6)), int(rng.integers(1, 4))
            out[at : at + width] = _sign(rng) * self.size * rng.uniform(0.5, 1.5)
        return out


EFFECTS: dict[str, type[Effect]] = {
    e.cause: e
    for e in (InitiationStage, RangeDependence, ExtremumDependence, DirectionAsymmetry, Creep,
              RateDependence, AmplifierLag, TimeSkew, ThermalDrift, MainsHum,
              PeriodicNonlinearity, Outliers)
}  # fmt: skip
