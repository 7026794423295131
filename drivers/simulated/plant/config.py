"""Everything that can be set in the plant, by name.

A rig's config gives a nested mapping; a cause's id from the catalogue is the key
of its effect::

    {"creep": {"on": true, "rate_per_decade": 0.012}, "thermal-drift": {"on": true}}

``settings()`` lists every key with its default, unit and meaning. Each effect is
defined in the file of its physics: electrical, actuator, strangers,
interferometer, acquisition.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from drivers.simulated.plant.acquisition import (
    Acquisition,
    ClockRatio,
    DroppedSamples,
    TimeSkew,
)
from drivers.simulated.plant.actuator import (
    Creep,
    CycleAging,
    DirectionAsymmetry,
    ExtremumDependence,
    Initiation,
    RangeDependence,
    RateDependence,
    Recovery,
    Remanence,
    Resonance,
    Stack,
)
from drivers.simulated.plant.effects import read, setting, table
from drivers.simulated.plant.electrical import (
    Amplifier,
    AmplifierLag,
    DriveClipping,
    DriveGain,
    SlewLimit,
)
from drivers.simulated.plant.interferometer import (
    ArNoise,
    BeamInterruption,
    FringeJump,
    Interferometer,
    MainsHum,
    OneOverFNoise,
    Outliers,
    PeriodicNonlinearity,
    Quantisation,
    Sensor,
    SensorClipping,
    SensorScale,
    SwitchTurned,
    ThermalDrift,
    WhiteNoise,
)
from drivers.simulated.plant.strangers import Strangers


@dataclass(frozen=True)
class PlantConfig:
    """Amplifier, actuator, interferometer and acquisition with all their effects."""

    seed: int = setting(1, "", "of every random number", low=0)
    # drive
    amplifier: Amplifier = field(default_factory=Amplifier)
    drive_clipping: DriveClipping = field(default_factory=DriveClipping)
    slew_limit: SlewLimit = field(default_factory=SlewLimit)
    amplifier_lag: AmplifierLag = field(default_factory=AmplifierLag)
    drive_gain: DriveGain = field(default_factory=DriveGain)
    # actuator
    stack: Stack = field(default_factory=Stack)
    initiation_stage: Initiation = field(default_factory=Initiation)
    range_dependence: RangeDependence = field(default_factory=RangeDependence)
    extremum_dependence: ExtremumDependence = field(default_factory=ExtremumDependence)
    direction_asymmetry: DirectionAsymmetry = field(default_factory=DirectionAsymmetry)
    creep: Creep = field(default_factory=Creep)
    rate_dependence: RateDependence = field(default_factory=RateDependence)
    resonance: Resonance = field(default_factory=Resonance)
    cycle_aging: CycleAging = field(default_factory=CycleAging)
    recovery: Recovery = field(default_factory=Recovery)
    remanence: Remanence = field(default_factory=Remanence)
    strangers: Strangers = field(default_factory=Strangers)
    # sensor
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
    # acquisition
    time_skew: TimeSkew = field(default_factory=TimeSkew)
    clock_ratio: ClockRatio = field(default_factory=ClockRatio)
    dropped_samples: DroppedSamples = field(default_factory=DroppedSamples)

    def __post_init__(self) -> None:
        if self.fringe_jump.times and not self.fringe_jump.multiples:
            raise ValueError("fringe_jump.multiples: needs at least one step")
        if self.sensor.polarity == 0:
            raise ValueError("sensor.polarity: must be -1 or +1")
        if self.drive_clipping.lower >= self.drive_clipping.upper:
            raise ValueError("drive_clipping.lower: must lie below drive_clipping.upper")
        if self.recovery.hold_off >= self.recovery.recovery_s:
            raise ValueError("recovery.hold_off: must be shorter than recovery.recovery_s")

    @classmethod
    def from_mapping(cls, given: Mapping[str, Any]) -> PlantConfig:
        """Read a nested mapping.

        Raises
        ------
        ValueError : a key is unknown or a value does not fit; the message begins
            with the dotted path of the key.
        """
        return read(cls, given)

    def interferometer(self) -> Interferometer:
        """The sensor with its errors."""
        return Interferometer(
            sensor=self.sensor,
            switch_turned=self.switch_turned,
            beam_interruption=self.beam_interruption,
            thermal_drift=self.thermal_drift,
            periodic_nonlinearity=self.periodic_nonlinearity,
            fringe_jump=self.fringe_jump,
            sensor_clipping=self.sensor_clipping,
            sensor_scale=self.sensor_scale,
            mains_hum=self.mains_hum,
            outliers=self.outliers,
            white_noise=self.white_noise,
            one_over_f_noise=self.one_over_f_noise,
            ar_noise=self.ar_noise,
            quantisation=self.quantisation,
        )

    def acquisition(self) -> Acquisition:
        """The digitizer's sampling with its errors."""
        return Acquisition(
            time_skew=self.time_skew,
            clock_ratio=self.clock_ratio,
            dropped_samples=self.dropped_samples,
        )


def settings() -> list[tuple[str, Any, str, str]]:
    """Every setting: dotted key, default, unit, meaning."""
    return table(PlantConfig)
