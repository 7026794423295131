"""Sensor clipping: the interferometer's analog output, or the digitizer's input, saturates.

Physics: the output ends at its supply; with the sensitivity switch set too fine the displacement
runs out of it.

Shows as: flat tops at one level in every sweep that reaches it, without creep and without a
memory: the actuator goes on, and where the record comes back the motion is what it would have
been. A clipped drive stops the actuator itself.

Remedy: Switch the sensor or the digitizer to a wider range, or stay below the level; what lies
beyond it was not measured.

Plausible: any level inside the travel; at the finest switch positions the first micrometres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import AT_BEST, Cause, Context, FloatArray
from piezo_rig.chain.drives import first_measured
from piezo_rig.chain.stage import Signal, Stage

# of the travel that is seen
SHARES = (0.9998, 0.9995, 0.999, 0.998, 0.9965, 0.9945, 0.992, 0.989, 0.984, 0.977, 0.965)
LEAST = 0.05  # of the travel, that it must go to a side for being clipped there


class SensorClipping(Cause):
    """``level`` above the sweep's zero at which it ends; a negative one ends it from below."""

    id = "sensor-clipping"
    place = "sensor"
    meanings: ClassVar[Mapping[str, str]] = {
        "level": "the sensor never shows more than this, or less if it is negative",
    }
    units: ClassVar[Mapping[str, str]] = {"level": "um"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"level": (-1e4, 1e4)}
    cuts_off = True  # a flat top
    sharp: ClassVar[Mapping[str, float]] = {"level": 3000.0}
    bending: ClassVar[str] = "level"
    known_to: ClassVar[float] = AT_BEST

    def act(self, signal: Signal) -> Signal:
        if not signal.displacement_um.size:
            return signal
        zero, level = _zero(signal), self["level"]
        within = np.minimum if level > 0 else np.maximum
        return signal.with_displacement(within(signal.displacement_um, zero + level))

    def carry(self, signal: Signal, changes: FloatArray) -> FloatArray:
        zero, level = _zero(signal), self["level"]
        off = (signal.displacement_um - zero - level) * np.sign(level)
        return np.asarray(changes * (off < 0.0))

    @classmethod
    def variants(cls, context: Context) -> list[list[Stage]]:
        inside = (1.0 - np.array(SHARES)) * context.travel_um
        levels = [
            end - np.copysign(inside, end)
            for end in context.ends_um if abs(end) > LEAST * context.travel_um
        ]  # fmt: skip
        return [[cls.of(None, level=float(v))] for v in np.concatenate(levels)] if levels else []

    @classmethod
    def begun(cls, trials: Sequence[Stage], shares: FloatArray) -> Stage:
        return trials[0]


def _zero(signal: Signal) -> float:
    """Where the sweep begins, behind whatever is played before one of unknown history."""
    return float(signal.displacement_um[first_measured(signal.time_s)])
