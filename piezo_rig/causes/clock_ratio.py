"""Clock ratio: generator and digitizer run on different time bases.

Physics: two quartz oscillators differ by some parts per million. A digitizer whose clock is fast
takes its samples too early: what it calls t is t / (1 + ppm 1e-6). Every sweep is triggered anew,
so the error begins at zero with each.

Shows as: a lag of the record behind the drive that grows linearly with time within a sweep, the
same in every repeat. A constant lag is a time skew.

Remedy: Run generator and digitizer from one reference clock; until then keep recordings short, or
let the model of the record put it right.

Plausible: 1-100 ppm between instruments; 20 ppm are one sample of 5 kHz after 10 s.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import Cause, Context
from piezo_rig.chain.stage import Signal, Stage

EXAMPLE = 0.1  # samples of lag at the end of the longest recording


class ClockRatio(Cause):
    """``ppm`` by which the digitizer's clock is fast."""

    id = "clock-ratio"
    place = "acquisition"
    largest: ClassVar[float] = 100.0
    meanings: ClassVar[Mapping[str, str]] = {
        "ppm": "by how much the digitizer's clock runs faster than the generator's",
    }
    units: ClassVar[Mapping[str, str]] = {"ppm": "ppm"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"ppm": (-1e5, 1e5)}

    def act(self, signal: Signal) -> Signal:
        if self["ppm"] == 0.0 or signal.time_s.size < 2:
            return signal
        since = np.maximum(signal.time_s, 0.0)  # before a sweep nobody measures
        seen = signal.time_s - since + since / (1.0 + 1e-6 * self["ppm"])
        return signal.with_displacement(
            np.interp(seen, signal.time_s, signal.displacement_um)
        )

    @classmethod
    def trials(cls, context: Context) -> list[Stage]:
        if context.duration_s <= 0.0:
            return []
        return [cls.of(None, ppm=1e6 * EXAMPLE * context.step_s / context.duration_s)]

    @classmethod
    def variants(cls, context: Context) -> list[list[Stage]]:
        # at a corner of the drive a clock that runs fast and one that runs slow both miss the peak
        return [[t.with_values(ppm=sign * t["ppm"])]
                for t in cls.trials(context) for sign in (1.0, -1.0)]  # fmt: skip
