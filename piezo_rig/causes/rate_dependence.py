"""Rate dependence: the loop opens with the speed of the drive.

Physics: moving domain walls feel a viscous drag, so that the displacement lags behind by a
length that grows with |dV/dt|, less than in proportion; exponents of 0.4 to 1 are reported.
In one form the lag is the same all along a half loop. In the other the thresholds of all sliders
widen with the speed (M. Al Janaideh and P. Krejci, IEEE/ASME Trans. Mechatronics 18 (2013) 1498),
while the first spring follows the drive. Walls need a time to follow: the rate is taken over it, or
the lag settles within it.

Shows as: loops that are wider where the drive is faster, everywhere but within milliseconds of
a corner. At one fixed frequency the rate is proportional to the range.

Remedy: Use the saved model at the speeds it has seen; play several frequencies before it is trusted
at others.

Plausible: 10-100 nm at 300 V/s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import Cause, Context, FloatArray
from piezo_rig.chain.branches import Branches
from piezo_rig.chain.increments import Increment, Operation
from piezo_rig.chain.stage import Signal, Stage

REFERENCE_V_PER_S = 300.0
USUAL_S = 3e-3
WINDOWS_S = (0.5e-3, 2e-3, 8e-3)
LONGEST_S = 0.03  # what takes longer to settle is creep
LOW, HIGH = 0.4, 1.0  # exponents of the two examples
LARGE_EXPONENTS, LARGE_TIMES = (0.4, 0.7, 1.0), (0.5, 1.0, 2.0, 4.0, 8.0)  # from which one begins


class RateDependence(Cause):
    """``lag_um`` at 300 V/s, and the ``exponent`` with which it grows.

    ``window_s`` : over which the rate is taken, or (``settles`` 1) within which the lag of the rate
    at hand settles. ``widens`` : 1 where thresholds widen, by what makes ``lag_um`` at the
    compliance ``um_per_v`` (the sliders' mean one by default); 0 where it is the same all along a
    half loop
    """

    id = "rate-dependence"
    place = "actuator"
    together = True
    law: ClassVar[Mapping[str, float]] = {"frequency": 0.05, "first rise": 0.05}
    of_speed = True
    units: ClassVar[Mapping[str, str]] = {"lag_um": "um", "exponent": "1"}
    optional: ClassVar[Mapping[str, str]] = {
        "window_s": "s", "widens": "1", "settles": "1", "um_per_v": "um/V",
    }  # fmt: skip
    given: ClassVar[tuple[str, ...]] = ("widens", "settles", "um_per_v")
    scanned: ClassVar[tuple[str, float]] = ("window_s", 2.0 ** (1 / 6))
    neutral: ClassVar[Mapping[str, float]] = {"exponent": 0.7}
    priors: ClassVar[Mapping[str, tuple[float, float]]] = {"exponent": (0.7, 0.2)}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {
        "lag_um": (0.0, np.inf), "exponent": (0.1, 2.0), "window_s": (1e-5, LONGEST_S),
    }

    def late_s(self, um_per_v: float) -> float:
        return abs(self["lag_um"]) / max(um_per_v * REFERENCE_V_PER_S, 1e-30)

    @property
    def passes(self) -> bool:
        """The lag hardly depends on the displacement."""
        return True

    @property
    def moves_sliders(self) -> bool:
        return self.widens

    def seen_by_sliders(self, signal: Signal, branches: Branches) -> FloatArray:
        from piezo_rig.chain.backlash import behind_each

        if not self.widens:
            return signal.drive_v
        drive = np.ascontiguousarray(signal.drive_v)
        width = self.widens_by_v(branches) * np.abs(self._rate(signal)) ** self["exponent"]
        return behind_each(signal.begins, drive, width)

    def widens_by_v(self, branches: Branches) -> float:
        """Volts by which thresholds widen at `REFERENCE_V_PER_S`; 0 in the other form."""
        if not self.widens:
            return 0.0
        if "um_per_v" in self.parameters:  # then the width does not hang on what elements become
            return self["lag_um"] / self["um_per_v"]
        return self["lag_um"] / _mean_compliance(branches)

    @property
    def window(self) -> float:
        """Seconds over which the rate is taken."""
        return self["window_s"] if "window_s" in self.parameters else USUAL_S

    def act(self, signal: Signal) -> Signal:
        if self.widens:
            return signal
        numbers = (self["lag_um"], self["exponent"], self.window, self.settles)
        lag = signal.of_drive.get((self.id, *numbers), lambda: self._lag(signal))
        return signal.with_displacement(signal.displacement_um - lag)

    def _lag(self, signal: Signal) -> FloatArray:
        size = signal.of_drive.get(
            (self.id, "size", self["exponent"], self.window, self.settles),
            lambda: self._settled(signal) if self.settles else self._drag(self._rate(signal)),
        )
        return np.asarray(self["lag_um"] * size)

    def _drag(self, rate: FloatArray) -> FloatArray:
        return np.asarray(np.sign(rate) * np.abs(rate) ** self["exponent"])

    def _settled(self, signal: Signal) -> FloatArray:
        """The drag of what the drive does between samples, settling within the window; (n,)."""
        from piezo_rig.chain.relaxation import off_each

        time = np.ascontiguousarray(signal.time_s)
        steps = np.maximum(np.diff(time), 1e-12)
        rate = np.diff(signal.drive_v) / steps / REFERENCE_V_PER_S
        rate[signal.begins[1:] - 1] = 0.0  # from one drive to the next
        whole = np.concatenate([[0.0], np.cumsum(self._drag(rate) * steps)])
        return np.asarray(-off_each(signal.begins, time, whole, self.window) / self.window)

    def otherwise(self) -> list[Stage]:
        usual = {"exponent": self.neutral["exponent"], "window_s": USUAL_S}
        if self.widens:
            return [self.with_values(widens=0.0, settles=s, **usual) for s in (0.0, 1.0)]
        return [self.with_values(settles=0.0 if self.settles else 1.0),
                self.with_values(widens=1.0, **usual)]  # fmt: skip

    def at_large(self, near: Stage | None = None) -> list[Stage]:
        """In both forms, at other exponents, lags and windows.

        From a lag that is far too small a descent ends at none, with an exponent at its limit.
        """
        if near is not None:
            return []
        return [
            self.with_values(
                lag_um=times * self["lag_um"], exponent=exponent, widens=widens, settles=0.0,
                window_s=window_s,
            )
            for widens in (0.0, 1.0) for exponent in LARGE_EXPONENTS for times in LARGE_TIMES
            for window_s in WINDOWS_S[1:]
        ]  # fmt: skip

    def increment(self, branches: Branches) -> Increment | str:
        rest = (self["exponent"], self.window, REFERENCE_V_PER_S)
        if self.widens:
            return Increment(Operation.WIDEN, (self.widens_by_v(branches), *rest))
        return Increment(Operation.DRAG, (self["lag_um"], *rest, float(self.settles)))

    @property
    def widens(self) -> bool:
        return "widens" in self.parameters and bool(self["widens"])

    @property
    def settles(self) -> bool:
        return "settles" in self.parameters and bool(self["settles"]) and not self.widens

    def _rate(self, signal: Signal) -> FloatArray:
        """Speed of the drive (n,), of `REFERENCE_V_PER_S`."""
        from piezo_rig.chain.relaxation import off_each

        def made() -> FloatArray:
            time = np.ascontiguousarray(signal.time_s)
            drive = np.ascontiguousarray(signal.drive_v)
            behind = off_each(signal.begins, time, drive, self.window)
            return np.asarray(-behind / self.window / REFERENCE_V_PER_S)

        return signal.of_drive.get((self.id, "rate", self.window), made)

    @classmethod
    def variants(cls, context: Context) -> list[list[Stage]]:
        speed = max(context.slew_v_per_s / REFERENCE_V_PER_S, 1e-9)
        size, um_per_v = 3e-4 * context.travel_um, _mean_compliance(context.model.branches())
        return [
            [cls.of(None, lag_um=size / speed**e, exponent=e, window_s=w, widens=s,
                    um_per_v=um_per_v)
             for e in (LOW, HIGH)]
            for s in (0.0, 1.0) for w in WINDOWS_S
        ]  # fmt: skip

    @classmethod
    def begun(cls, trials: Sequence[Stage], shares: FloatArray) -> Stage:
        slow, fast = (t["lag_um"] for t in trials)
        # both examples are as large as each other at the speed that is usual in the data
        speed = (slow / fast) ** (1.0 / (HIGH - LOW))
        total = float(shares.sum())
        share = float(np.clip(shares[1] / total, 0.0, 1.0)) if total else 0.5
        exponent = LOW + (HIGH - LOW) * share
        lag = max(total, 0.1) * slow * speed ** (LOW - exponent)
        kept = {n: trials[0][n] for n in cls.optional if n in trials[0].parameters}
        return cls.of(None, lag_um=lag, exponent=exponent, **kept)


def _mean_compliance(branches: Branches) -> float:
    """Of all sliders together, um/V."""
    rest = branches.rest
    volts = np.diff(rest.knots_v, prepend=0.0)
    moved = float(volts @ rest.compliance_um_per_v[: volts.size])
    return float(moved / rest.knots_v[-1] if moved else rest.compliance_um_per_v[-1])
