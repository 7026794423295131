"""Thermal drift: the zero moves with clock time, not with the drive.

Physics: frame, mount and dead path of the interferometer warm up; 100 mm of air alone changes by
95 nm/K. Over one recording that is a straight line in clock time. Every recording has its own
free offset, so only the slope within recordings counts.

Shows as: a slope that is the same at rest, in holds and while driving. Where the drive only ever
grows, creep looks much the same.

Plausible: 10-200 nm/min.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from piezo_rig.causes.cause import Cause, Context
from piezo_rig.chain.stage import Signal, Stage


class ThermalDrift(Cause):
    """``rate`` of the zero, nm/s."""

    id = "thermal-drift"
    place = "sensor"
    locked_to = "clock"
    units: ClassVar[Mapping[str, str]] = {"rate": "nm/s"}

    def act(self, signal: Signal) -> Signal:
        moved = 1e-3 * self["rate"] * (signal.time_s - signal.time_s[0])
        return signal.with_displacement(signal.displacement_um + moved)

    @classmethod
    def trials(cls, context: Context) -> list[Stage]:
        return [cls.of(None, rate=1e3 * 1e-4 * context.travel_um / max(context.duration_s, 1e-9))]
