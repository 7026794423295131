"""Clock ratio: generator and digitizer run on different time bases.

Physics: two quartz oscillators differ by some parts per million. A digitizer whose clock is fast
takes its samples too early: what it calls t is t / (1 + ppm 1e-6). Every sweep is triggered anew,
so the error begins at zero with each. Of recordings that carry on from each other after a pause
each may be triggered by itself as well (``anew`` 1), or the clocks run on through all of them (0).

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
from numpy.typing import NDArray

from piezo_rig.causes.cause import Cause, Context
from piezo_rig.chain.stage import Signal, Stage

FloatArray = NDArray[np.float64]
PAUSE, PAUSE_S = 3.0, 0.02  # sampling steps, at least, from one recording to the next
EXAMPLE = 0.1  # samples of lag at the end of the longest recording


class ClockRatio(Cause):
    """``ppm`` by which the digitizer's clock is fast."""

    id = "clock-ratio"
    place = "acquisition"
    largest: ClassVar[float] = 100.0
    meanings: ClassVar[Mapping[str, str]] = {
        "ppm": "by how much the digitizer's clock runs faster than the generator's",
        "anew": "1: it begins with each recording; 0: it runs on through those that carry on",
    }
    units: ClassVar[Mapping[str, str]] = {"ppm": "ppm"}
    optional: ClassVar[Mapping[str, str]] = {"anew": "1"}
    given: ClassVar[tuple[str, ...]] = ("anew",)
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"ppm": (-1e5, 1e5)}

    def act(self, signal: Signal) -> Signal:
        if self["ppm"] == 0.0 or signal.time_s.size < 2:
            return signal
        since = np.maximum(signal.time_s, 0.0)  # before a sweep nobody measures
        if "anew" in self.parameters and self["anew"] > 0.0:
            since = since - signal.of_drive.get("triggered", lambda: _triggered_s(since))
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
        forms = ({"anew": 1.0}, {"anew": 0.0}) if context.pauses else ({},)
        return [[t.with_values(ppm=sign * t["ppm"], **form)]
                for t in cls.trials(context) for sign in (1.0, -1.0) for form in forms]


def _triggered_s(time_s: FloatArray) -> FloatArray:
    """When the recording of each sample (n,) began, s: it began behind a pause."""
    begins = np.append(0, 1 + pauses(time_s))
    return np.repeat(time_s[begins], np.diff(begins, append=time_s.size))


def pauses(time_s: FloatArray) -> NDArray[np.int64]:
    """Last samples before recordings that begin after a pause."""
    steps = np.diff(time_s)
    moving = steps[steps > 0.0]  # what is put before a drive stands at one time
    usual = float(np.median(moving)) if moving.size else 0.0
    return np.flatnonzero(steps > max(PAUSE * usual, PAUSE_S))
