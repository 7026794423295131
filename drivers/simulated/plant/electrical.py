"""From the generator's command to the voltage on the stack.

The amplifier adds its set voltage to the amplified command, saturates, is
limited in current (a capacitive load turns that into a limit of |dV/dt|), and
follows through the output resistance into the 1.5 uF of the stack: a
first-order lag of 15-150 us. Units: V, s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.simulated.plant.effects import setting, switch


@dataclass(frozen=True)
class Amplifier:
    """Nominal amplifier: drive = gain x command + offset."""

    gain: float = setting(7.5, "V/V", "drive per command")
    offset: float = setting(75.0, "V", "set voltage at switch-on; drive at 0 V of command")


@dataclass(frozen=True)
class DriveClipping:
    """The amplifier saturates inside the commanded range."""

    on: bool = switch(False)
    lower: float = setting(0.0, "V", "lowest drive that it delivers")
    upper: float = setting(75.0, "V", "highest drive that it delivers")


@dataclass(frozen=True)
class SlewLimit:
    """The current limit bounds |dV/dt| into the stack's capacitance."""

    on: bool = switch(False)
    limit: float = setting(250.0, "V/s", "largest |dV/dt|", low=1e-3)


@dataclass(frozen=True)
class AmplifierLag:
    """First-order lag of output resistance and stack capacitance; tau = 0 is no lag."""

    on: bool = switch(True)
    tau: float = setting(40e-6, "s", "time constant", low=0.0, high=1.0)


@dataclass(frozen=True)
class DriveGain:
    """The gain differs from its calibration."""

    on: bool = switch(False)
    ratio: float = setting(1.02, "1", "true / nominal", low=0.1, high=10.0)
    pivot: float = setting(
        0.0, "V", "drive that stays right: 0 scales the whole drive, 75 only the command's share"
    )


def nominal_to_target(
    command: NDArray[np.float64],
    gain: float,
    offset: float,
    drive_gain: DriveGain,
    clipping: DriveClipping,
) -> NDArray[np.float64]:
    """Volts that the amplifier heads for, one per command; all of it memoryless."""
    drive = gain * np.asarray(command, dtype=np.float64) + offset
    if drive_gain.on:
        drive = drive_gain.pivot + drive_gain.ratio * (drive - drive_gain.pivot)
    if clipping.on:
        drive = np.clip(drive, clipping.lower, clipping.upper)
    return drive
