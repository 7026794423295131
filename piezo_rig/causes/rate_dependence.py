"""Rate dependence: the loop opens with the speed of the drive.

Physics: moving domain walls feel a viscous drag, so that the displacement lags behind by a
length that grows with |dV/dt|, less than in proportion. M. Al Janaideh and P. Krejci, IEEE/ASME
Trans. Mechatronics 18 (2013) 1498 put the same into rate-dependent thresholds; exponents of 0.4
to 1 are reported. The rate is taken over 3 ms, the time that walls need to follow.

Shows as: loops that are wider where the drive is faster, everywhere but within milliseconds of
a corner. At one fixed frequency the rate is proportional to the range.

Plausible: 10-100 nm at 300 V/s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import Cause, Context, FloatArray
from piezo_rig.chain.stage import Signal, Stage

REFERENCE_V_PER_S = 300.0
WINDOW_S = 3e-3
MOST = 5.0  # local over mean slope
LOW, HIGH = 0.4, 1.0  # exponents of the two examples


class RateDependence(Cause):
    """``lag_um`` at 300 V/s, and the ``exponent`` with which it grows.

    ``by_slope`` : 1 where the lag is one of the drive (wider thresholds): in proportion to the
    local slope, ``lag_um`` at the mean slope; 0 where it is the same all along a half loop
    """

    id = "rate-dependence"
    place = "actuator"
    law: ClassVar[tuple[tuple[str, ...], float]] = (("frequency",), 0.05)
    needs_speeds = True
    passes = True  # the lag hardly depends on the displacement
    units: ClassVar[Mapping[str, str]] = {"lag_um": "um", "exponent": "1"}
    optional: ClassVar[Mapping[str, str]] = {"by_slope": "1"}
    given: ClassVar[tuple[str, ...]] = ("by_slope",)
    neutral: ClassVar[Mapping[str, float]] = {"exponent": 0.7}
    priors: ClassVar[Mapping[str, tuple[float, float]]] = {"exponent": (0.7, 0.2)}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {
        "lag_um": (0.0, np.inf), "exponent": (0.1, 2.0),
    }

    def act(self, signal: Signal) -> Signal:
        from piezo_rig.chain.relaxation import lagged

        time = np.ascontiguousarray(signal.time_s)
        drive = np.ascontiguousarray(signal.drive_v)
        moved = drive - lagged(time, drive, WINDOW_S)
        rate = moved / WINDOW_S / REFERENCE_V_PER_S
        lag = self["lag_um"] * np.sign(rate) * np.abs(rate) ** self["exponent"]
        if "by_slope" in self.parameters and self["by_slope"]:
            x = np.ascontiguousarray(signal.displacement_um)
            followed = x - lagged(time, x, WINDOW_S)
            whole = max(float(np.ptp(x)), 1e-30) / max(float(np.ptp(drive)), 1e-30)
            known = np.abs(moved) > 1e-9 * max(float(np.ptp(drive)), 1e-30)
            slope = np.divide(followed, moved, out=np.zeros_like(x), where=known) / whole
            lag = lag * np.clip(slope, 0.0, MOST)
        return signal.with_(displacement_um=signal.displacement_um - lag)

    @classmethod
    def variants(cls, context: Context) -> list[list[Stage]]:
        speed = max(context.slew_v_per_s / REFERENCE_V_PER_S, 1e-9)
        size = 3e-4 * context.travel_um
        return [
            [cls.of(None, lag_um=size / speed**e, exponent=e, by_slope=s) for e in (LOW, HIGH)]
            for s in (0.0, 1.0)
        ]

    @classmethod
    def begun(cls, trials: Sequence[Stage], shares: FloatArray) -> Stage:
        lags = np.array([t["lag_um"] for t in trials]) * shares
        total = float(lags.sum())
        share = float(np.clip(lags[1] / total, 0.0, 1.0)) if total else 0.5
        exponent = LOW + (HIGH - LOW) * share
        return cls.of(None, lag_um=total, exponent=exponent, by_slope=trials[0]["by_slope"])
