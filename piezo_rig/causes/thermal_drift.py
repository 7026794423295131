"""Thermal drift: the zero moves with clock time, not with the drive.

Physics: frame, mount and dead path of the interferometer warm up; 100 mm of air alone changes by
95 nm/K. Over one recording that is a straight line in clock time. Every recording has its own
free offset, so only the slope within recordings counts. A frame that has been switched on or
touched settles: the slope dies away over the session, by an exponential in its clock.

Shows as: a slope that is the same at rest, in holds and while driving, and in the next recording,
or less the later a recording was made. Where the drive only ever grows, creep looks much the same.

Remedy: Let the rig warm up, cover the beam path, and record in random order; only the zero moves,
the travel is right.

Plausible: 10-200 nm/min.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import Cause, Context
from piezo_rig.chain.stage import Signal, Stage

SETTLING = (0.7, 2.0, 8.0)  # times that the slope falls to a third within a session
SESSION = 2.0  # recordings that are a session: within one, what settles is creep as well


class ThermalDrift(Cause):
    """``rate`` of the zero, nm/s; with ``settling`` (1/s) that at the beginning of the session.

    The signal's time is that of the session.
    """

    id = "thermal-drift"
    place = "sensor"
    locked_to = "clock"
    meanings: ClassVar[Mapping[str, str]] = {
        "rate": "at the beginning, with the clock",
        "settling": "how quickly it dies away; 0: it does not",
    }
    units: ClassVar[Mapping[str, str]] = {"rate": "nm/s"}
    largest: ClassVar[float] = 300.0  # a short recording shows none but a fast one
    optional: ClassVar[Mapping[str, str]] = {"settling": "1/s"}
    scanned: ClassVar[tuple[str, float]] = ("settling", 1.5)
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"settling": (1e-7, 1e3)}

    def act(self, signal: Signal) -> Signal:
        time, settling = signal.time_s, self["settling"] if "settling" in self.parameters else 0.0
        begun = time[0]
        if settling:
            moved = np.exp(-settling * begun) * -np.expm1(-settling * (time - begun)) / settling
        else:
            moved = time - begun
        return signal.with_displacement(signal.displacement_um + 1e-3 * self["rate"] * moved)

    @classmethod
    def variants(cls, context: Context) -> list[list[Stage]]:
        rate = 1e3 * 1e-4 * context.travel_um / max(context.duration_s, 1e-9)
        return [[cls.of(None, rate=rate)], *([s] for s in cls._settling(rate, context))]

    def also(self, context: Context) -> list[Stage]:
        """Dying away over the session, with the same slope in its middle.

        Beside another effect as large, a slope that settles may first look like a steady one.
        """
        if self["rate"] == 0.0 or "settling" in self.parameters:
            return []
        forms = self._settling(self["rate"], context)
        middle = 0.5 * context.session_s
        return [s.with_values(rate=s["rate"] * np.exp(s["settling"] * middle)) for s in forms]

    @classmethod
    def _settling(cls, rate: float, context: Context) -> list[Stage]:
        """None within one recording, where what settles is creep as well."""
        if context.session_s <= SESSION * context.duration_s:
            return []
        return [cls.of(None, rate=rate, settling=n / context.session_s) for n in SETTLING]
