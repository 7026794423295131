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
LOW, HIGH = 0.4, 1.0  # exponents of the two examples


class RateDependence(Cause):
    """``lag_um`` at 300 V/s, and the ``exponent`` with which it grows."""

    id = "rate-dependence"
    place = "actuator"
    law: ClassVar[tuple[tuple[str, ...], float]] = (("frequency",), 0.05)
    needs_speeds = True
    units: ClassVar[Mapping[str, str]] = {"lag_um": "um", "exponent": "1"}
    neutral: ClassVar[Mapping[str, float]] = {"exponent": 0.7}
    priors: ClassVar[Mapping[str, tuple[float, float]]] = {"exponent": (0.7, 0.2)}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"exponent": (0.1, 2.0)}

    def act(self, signal: Signal) -> Signal:
        from piezo_rig.chain.relaxation import lagged

        drive = np.ascontiguousarray(signal.drive_v)
        behind = lagged(np.ascontiguousarray(signal.time_s), drive, WINDOW_S)
        rate = (drive - behind) / WINDOW_S / REFERENCE_V_PER_S
        lag = self["lag_um"] * np.sign(rate) * np.abs(rate) ** self["exponent"]
        return signal.with_(displacement_um=signal.displacement_um - lag)

    @classmethod
    def trials(cls, context: Context) -> list[Stage]:
        speed = max(context.slew_v_per_s / REFERENCE_V_PER_S, 1e-9)
        size = 3e-4 * context.travel_um
        return [cls.of(None, lag_um=size / speed**e, exponent=e) for e in (LOW, HIGH)]

    @classmethod
    def begun(cls, trials: Sequence[Stage], shares: FloatArray) -> Stage:
        lags = np.array([t["lag_um"] for t in trials]) * shares
        total = float(lags.sum())
        share = float(np.clip(lags[1] / total, 0.0, 1.0)) if total else 0.5
        return cls.of(None, lag_um=total, exponent=LOW + (HIGH - LOW) * share)
