"""Time skew: the record lags, record(t) = displacement(t - delay).

Physics: the interferometer's digital filter, its analog output's converter, an anti-aliasing
filter, or channels that are sampled one after the other delay the sensor against the drive.

Shows as: loops that open in proportion to the speed of the displacement, without any rounding of
corners. A lag of the drive differs only within a few milliseconds of corners; several
frequencies or a recorded drive monitor separate them. A record that begins late, and a generator
that holds each sample until the next, delay monitor and sensor alike; the delay here is the whole
one.

Remedy: Nothing is wrong with the stack: put the delay into the evaluation, or let digitizer and
generator share a trigger; `compensate` leads by it.

Plausible: 10 us to 1 ms; tens of milliseconds for buffered sensors.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import NEAR_IN_TIME, Cause, Context, FloatArray
from piezo_rig.chain.stage import Signal, Stage


class TimeSkew(Cause):
    """``delay`` of the record behind the displacement."""

    id = "time-skew"
    place = "acquisition"
    together = True
    of_speed = True
    lasting: ClassVar[str] = "delay"
    kinked: ClassVar[str] = "delay"
    near: ClassVar[float] = NEAR_IN_TIME
    meanings: ClassVar[Mapping[str, str]] = {
        "delay": "of the sensor's channel after the drive's",
    }
    units: ClassVar[Mapping[str, str]] = {"delay": "s"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"delay": (-1.0, 1.0)}

    def act(self, signal: Signal) -> Signal:
        if self["delay"] == 0.0 or signal.time_s.size < 2:
            return signal
        return signal.with_displacement(self.carry(signal, signal.displacement_um[None])[0])

    def carry(self, signal: Signal, changes: FloatArray) -> FloatArray:
        from piezo_rig.chain.shifting import shifted_each

        time, rows = (np.ascontiguousarray(x) for x in (signal.time_s, changes))
        return np.asarray(shifted_each(signal.begins, time, rows, self["delay"]))

    @classmethod
    def trials(cls, context: Context) -> list[Stage]:
        return [cls.of(None, delay=max(2e-5, 0.1 * context.step_s))]
