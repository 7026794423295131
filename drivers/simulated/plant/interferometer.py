"""What the interferometer makes of a displacement: its errors, and its analogue output.

Every effect adds to, or bends, the measured displacement in um at bench time t;
then come scale, polarity, the analogue output's converter and its limit.
Random parts are functions of the bench time alone (``noise.py``), so asking
twice gives the same answer.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.simulated.plant.effects import setting, switch

Array = NDArray[np.float64]

# Printed on the instrument, um/V, switch positions 0..6.
SENSITIVITY_UM_PER_V = (0.24, 0.97, 3.87, 15.48, 61.9, 247.61, 990.44)
HALF_WAVE_UM = 0.3164
EIGHTH_WAVE_UM = 0.0791


@dataclass(frozen=True)
class Sensor:
    """The analogue output: volts = zero_v + polarity x displacement / sensitivity."""

    switch: int = setting(3, "1", "sensitivity switch", low=0, high=6)
    zero_v: float = setting(0.0, "V", "output of the recovered actuator")
    polarity: int = setting(-1, "1", "sign of volts per displacement", low=-1, high=1)
    limit_v: float = setting(10.0, "V", "largest output of either sign", low=0.0)


@dataclass(frozen=True)
class SwitchTurned:
    """Somebody turns the sensitivity switch while nobody looks."""

    on: bool = switch(False)
    time: float = setting(0.0, "s", "bench time from which it stands elsewhere", low=0.0)
    switch: int = setting(4, "1", "where it stands then", low=0, high=6)


@dataclass(frozen=True)
class BeamInterruption:
    """Something gets into the beam: the output stands still, and the count is lost."""

    on: bool = switch(False)
    times: tuple[float, ...] = setting((), "s", "bench times at which the beam is lost")
    duration: float = setting(0.05, "s", "how long it is lost each time", low=0.0)
    volts: float = setting(0.0, "V", "output while it is lost")
    lost_um: float = setting(0.2, "um", "error of the count each time")


@dataclass(frozen=True)
class ThermalDrift:
    """The frame and the dead path change length with clock time."""

    on: bool = switch(False)
    rate: float = setting(0.5, "nm/s", "steady part")
    walk: float = setting(0.0, "nm/sqrt(s)", "random walk beside it", low=0.0)


@dataclass(frozen=True)
class PeriodicNonlinearity:
    """Polarisation mixing: an error periodic in displacement, lambda/2 = 316.4 nm."""

    on: bool = switch(False)
    amplitude: float = setting(3.0, "nm", "peak of the first order")
    second_harmonic: float = setting(0.25, "1", "second order over first")
    phase: float = setting(0.7, "rad", "phase of the first order at zero displacement")


@dataclass(frozen=True)
class FringeJump:
    """The counter loses steps of lambda/8 = 79.1 nm, at given instants or at random."""

    on: bool = switch(False)
    times: tuple[float, ...] = setting((), "s", "bench times of the jumps")
    multiples: tuple[int, ...] = setting((1,), "79.1 nm", "steps, taken in turn")
    per_second: float = setting(0.0, "1/s", "random jumps beside them, sign at random", 0.0, 1.0)


@dataclass(frozen=True)
class SensorClipping:
    """The measured displacement stops at a level."""

    on: bool = switch(False)
    level: float = setting(8.0, "um", "above the recovered actuator")


@dataclass(frozen=True)
class SensorScale:
    """The sensitivity (um/V) is not the one on the label."""

    on: bool = switch(False)
    ratio: float = setting(1.01, "1", "true / nominal", low=0.1, high=10.0)


@dataclass(frozen=True)
class MainsHum:
    """Mains and its odd harmonics, in clock time."""

    on: bool = switch(False)
    frequency: float = setting(50.0, "Hz", "fundamental", low=1.0)
    amplitude: float = setting(3.0, "nm", "peak of the fundamental")
    third: float = setting(0.4, "1", "third harmonic over fundamental")
    fifth: float = setting(0.2, "1", "fifth harmonic over fundamental")


@dataclass(frozen=True)
class Outliers:
    """Isolated spikes, as from an interrupted beam."""

    on: bool = switch(False)
    per_second: float = setting(2.0, "1/s", "rate", low=0.0)
    height: float = setting(200.0, "nm", "median height, sign at random", low=0.0)


@dataclass(frozen=True)
class WhiteNoise:
    """Detector noise; its bandwidth exceeds every sample rate used, so rms is per sample."""

    on: bool = switch(True)
    rms: float = setting(2.0, "nm", "per sample, at any rate", low=0.0)


@dataclass(frozen=True)
class OneOverFNoise:
    """Air path and frame: power 1/f from 0.02 Hz to 2.5 kHz."""

    on: bool = switch(True)
    rms: float = setting(2.0, "nm", "over a sweep of 5 s", low=0.0)


@dataclass(frozen=True)
class ArNoise:
    """First-order autoregressive noise, for studies of false alarms."""

    on: bool = switch(False)
    rms: float = setting(5.0, "nm", "stationary", low=0.0)
    coefficient: float = setting(0.95, "1", "from sample to sample at 5 kSa/s", low=0.0, high=0.99)


@dataclass(frozen=True)
class Quantisation:
    """The converter behind the analogue output."""

    on: bool = switch(True)
    bits: int = setting(16, "bit", "resolution over both signs", low=2, high=32)
    full_scale: float = setting(10.0, "V", "of either sign", low=1e-6)


@dataclass(frozen=True)
class Interferometer:
    """The instrument and everything that can be wrong with it."""

    sensor: Sensor = field(default_factory=Sensor)
    switch_turned: SwitchTurned = field(default_factory=SwitchTurned)
    beam_interruption: BeamInterruption = field(default_factory=BeamInterruption)
    thermal_drift: ThermalDrift = field(default_factory=ThermalDrift)
    periodic_nonlinearity: PeriodicNonlinearity = field(default_factory=PeriodicNonlinearity)
    fringe_jump: FringeJump = field(default_factory=FringeJump)
    sensor_clipping: SensorClipping = field(default_factory=SensorClipping)
    sensor_scale: SensorScale = field(default_factory=SensorScale)
    mains_hum: MainsHum = field(default_factory=MainsHum)
    outliers: Outliers = field(default_factory=Outliers)
    white_noise: WhiteNoise = field(default_factory=WhiteNoise)
    one_over_f_noise: OneOverFNoise = field(default_factory=OneOverFNoise)
    ar_noise: ArNoise = field(default_factory=ArNoise)
    quantisation: Quantisation = field(default_factory=Quantisation)

    def volts(self, um: Array, t: Array, tick: int, rate: float, seed: int) -> Array:
        """Sensor volts (n,) for displacements um (n,) at bench times t (n,).

        ``tick`` is the number of the first sample counted at ``rate`` from bench
        time 0; it names the noise that belongs to each sample.
        """
        from drivers.simulated.plant import noise

        seen = um.copy()
        if self.thermal_drift.on:
            seen += 1e-3 * self.thermal_drift.rate * t
            if self.thermal_drift.walk:
                seen += 1e-3 * self.thermal_drift.walk * noise.random_walk(seed, t)
        if self.periodic_nonlinearity.on:
            seen += self._periodic_error(seen)
        if self.fringe_jump.on:
            seen += self._jumps(t, seed)
        if self.mains_hum.on:
            seen += self._hum(t, seed)
        if self.sensor_clipping.on:
            np.minimum(seen, self.sensor_clipping.level, out=seen)
        if self.white_noise.on:
            noise.add_white(seen, 1e-3 * self.white_noise.rms, seed, tick, rate)
        if self.one_over_f_noise.on:
            noise.add_one_over_f(seen, 1e-3 * self.one_over_f_noise.rms, seed, t)
        if self.ar_noise.on:
            coefficient = self.ar_noise.coefficient ** (5000.0 / rate)
            noise.add_ar(seen, 1e-3 * self.ar_noise.rms, coefficient, seed, tick, rate)
        if self.outliers.on:
            chance = self.outliers.per_second / rate
            noise.add_outliers(seen, 1e-3 * self.outliers.height, chance, seed, tick, rate)
        if self.beam_interruption.on:
            lost = np.searchsorted(self._beam_lost(), t, side="right")
            seen += self.beam_interruption.lost_um * lost
        return self._output(seen, t)

    def _beam_lost(self) -> Array:
        return np.sort(np.asarray(self.beam_interruption.times, dtype=np.float64))

    def _periodic_error(self, um: Array) -> Array:
        effect = self.periodic_nonlinearity
        angle = 2.0 * np.pi * um / HALF_WAVE_UM + effect.phase
        second = effect.second_harmonic * np.sin(2.0 * angle)
        return np.asarray(1e-3 * effect.amplitude * (np.sin(angle) + second))

    def _jumps(self, t: Array, seed: int) -> Array:
        from drivers.simulated.plant import noise

        effect = self.fringe_jump
        times = np.asarray(effect.times, dtype=np.float64)
        steps = np.resize(np.asarray(effect.multiples, dtype=np.float64), times.shape)
        if effect.per_second > 0.0 and t.size:
            more, signs = noise.random_instants(seed, effect.per_second, float(t[-1]))
            times, steps = np.concatenate([times, more]), np.concatenate([steps, signs])
        order = np.argsort(times, kind="stable")
        total = np.concatenate([[0.0], np.cumsum(steps[order])])
        return np.asarray(EIGHTH_WAVE_UM * total[np.searchsorted(times[order], t, side="right")])

    def _hum(self, t: Array, seed: int) -> Array:
        from drivers.simulated.plant import noise

        effect = self.mains_hum
        angle = 2.0 * np.pi * effect.frequency * t + noise.phase(seed)
        shape = np.sin(angle) + effect.third * np.sin(3 * angle) + effect.fifth * np.sin(5 * angle)
        return np.asarray(1e-3 * effect.amplitude * shape)

    def _output(self, um: Array, t: Array) -> Array:
        scale: Array | float = SENSITIVITY_UM_PER_V[self.sensor.switch]
        if self.switch_turned.on:
            turned = SENSITIVITY_UM_PER_V[self.switch_turned.switch]
            scale = np.where(t >= self.switch_turned.time, turned, scale)
        if self.sensor_scale.on:
            scale *= self.sensor_scale.ratio
        volts = self.sensor.zero_v + self.sensor.polarity * um / scale
        if self.quantisation.on:
            step = 2.0 * self.quantisation.full_scale / 2.0**self.quantisation.bits
            volts = step * np.round(volts / step)
        if self.beam_interruption.on:
            for begin in self._beam_lost():
                dark = (t >= begin) & (t < begin + self.beam_interruption.duration)
                volts[dark] = self.beam_interruption.volts
        return np.asarray(np.clip(volts, -self.sensor.limit_v, self.sensor.limit_v))
