"""Mains hum: 50 or 60 Hz and odd harmonics on the sensor, in clock time.

Physics: ground loops and stray fields couple the mains into the sensor's analog line; saturating
transformers make the odd harmonics. The phase belongs to the clock, not to the drive, so repeats
differ by it (unless they begin in step with the mains).

Shows as: narrow lines at 50, 150, 250 (60, 180, 300) Hz. A 2 Hz drive has lines there too:
averages over cycles or repeats do not tell them apart, differences between repeats do.

Remedy: Look for ground loops, cables beside power lines, and supplies at the sensor; a hum of the
drive itself would show in the drive monitor.

Plausible: a few nm.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import Cause
from piezo_rig.chain.stage import Signal

FUNDAMENTALS_HZ = (50.0, 60.0)
ORDERS = (1, 3, 5)


class MainsHum(Cause):
    """``frequency`` of the fundamental and its peak ``amplitude``; phases are not kept."""

    id = "mains-hum"
    place = "sensor"
    locked_to = "clock"
    meanings: ClassVar[Mapping[str, str]] = {
        "frequency": "of the line, as the recording's clock has it",
        "amplitude": "of its fundamental",
    }
    units: ClassVar[Mapping[str, str]] = {"frequency": "Hz", "amplitude": "nm"}

    def act(self, signal: Signal) -> Signal:
        wave = np.sin(2.0 * np.pi * self["frequency"] * signal.time_s)
        return signal.with_displacement(
            signal.displacement_um + 1e-3 * self["amplitude"] * wave
        )
