"""Rate dependence: the loop opens with the speed of the drive.

Physics: moving domain walls feel a viscous drag, so that the displacement lags behind by a
length that grows with |dV/dt|, less than in proportion; exponents of 0.4 to 1 are reported.
In one form the lag is the same all along a half loop. In the others the thresholds of all sliders
widen with the speed, by the same volts (M. Al Janaideh and P. Krejci, IEEE/ASME Trans. Mechatronics
18 (2013) 1498) or by the same share of themselves (M. Al Janaideh, S. Rakheja and C.-Y. Su,
Mechatronics 19 (2009) 656), while the first spring follows the drive. Walls need a time to follow:
the rate is taken over it, or the lag settles within it. What is thermally
activated levels off: it grows with the logarithm of the speed.

Shows as: loops that are wider where the drive is faster, everywhere but within milliseconds of
a corner. At one fixed frequency the rate is proportional to the range.

Remedy: Use the saved model at the speeds it has seen; play several frequencies before it is trusted
at others.

Plausible: 10-100 nm at 300 V/s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import Cause, Context, FloatArray
from piezo_rig.chain.branches import Branches, sliders
from piezo_rig.chain.increments import Increment, Operation
from piezo_rig.chain.stage import Parameter, Signal, Stage, Wider
from piezo_rig.errors import InputError

REFERENCE_V_PER_S = 300.0
NONE = Parameter(0.0, "1")
USUAL_S = 3e-3
WINDOWS_S = (0.5e-3, 2e-3, 8e-3)
AT_ONCE_S = 0.1e-3  # of what follows the speed at once: its corners are as sharp
FINE = 2.0  # samples within that, from which on it is told from what follows later
SHAPE_WINDOWS_S = (0.1e-3, 0.5e-3, 2e-3, 8e-3)
SHAPE_EXPONENTS = ((0.4, 0.7, 1.0), (0.5, 0.75))  # of powers, and of lags that level off
LEVELS, HALVED = (0.02, 0.98), 60  # exponents of lags that level off; bits to which one is found
LONGEST_S = 0.03  # what takes longer to settle is creep
LOW, HIGH = 0.4, 1.0  # exponents of the two examples
LARGE_EXPONENTS, LARGE_TIMES = (0.4, 0.7, 1.0), (0.5, 1.0, 2.0, 4.0, 8.0)  # from which one begins


class RateDependence(Cause):
    """``lag_um`` at 300 V/s, and the ``exponent`` with which it grows.

    ``window_s`` : over which the rate is taken, or (``settles`` 1) within which the lag of the rate
    at hand settles. ``widens`` : 0 where the lag is the same all along a half loop; 1 where all
    thresholds widen by the volts that make ``lag_um`` at the compliance ``um_per_v`` (the sliders'
    mean one by default); 2 where they widen by the share ``lag_um`` of ``opens_um``, which is by
    how much all sliders together are behind. ``levels_off`` : 1 where it grows with the logarithm
    of 1 and the speed (of what is thermally activated), with ``exponent`` at 300 V/s
    """

    id = "rate-dependence"
    place = "actuator"
    together = True
    law: ClassVar[Mapping[str, float]] = {"frequency": 0.05, "first rise": 0.05}
    of_speed = True
    at_one_frequency: ClassVar[Mapping[str, float]] = {
        "range": 0.1, "range+drive": 0.1, "direction": 0.1, "time_since_turn+direction": 0.1,
    }  # fmt: skip
    leaves: ClassVar[float] = 0.1  # other laws of it are as likely
    meanings: ClassVar[Mapping[str, str]] = {
        "lag_um": "how far the displacement is behind at 300 V/s",
        "exponent": "power of the speed that it grows with there",
        "window_s": "time over which the speed is taken, or after which it has settled",
        "widens": "0: all lags; 1: thresholds widen, all alike; 2: each by a share of itself",
        "settles": "1: it settles after a change of speed; 0: it follows at once",
        "um_per_v": "slope that turns volts into displacement",
        "opens_um": "what the share is of: by how much all sliders together are behind",
        "levels_off": "1: it grows with the logarithm of the speed; 0: with a power",
    }
    units: ClassVar[Mapping[str, str]] = {"lag_um": "um", "exponent": "1"}
    optional: ClassVar[Mapping[str, str]] = {
        "window_s": "s", "widens": "1", "settles": "1", "um_per_v": "um/V", "opens_um": "um",
        "levels_off": "1",
    }  # fmt: skip
    given: ClassVar[tuple[str, ...]] = ("widens", "settles", "um_per_v", "opens_um", "levels_off")
    sized: ClassVar[tuple[str, ...]] = ("lag_um",)
    scanned: ClassVar[tuple[str, float]] = ("window_s", 2.0 ** (1 / 6))
    neutral: ClassVar[Mapping[str, float]] = {"exponent": 0.7}
    priors: ClassVar[Mapping[str, tuple[float, float]]] = {"exponent": (0.7, 0.2)}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {
        "lag_um": (0.0, np.inf), "exponent": (0.1, 2.0), "window_s": (1e-5, LONGEST_S),
    }

    @property
    def by_form(self) -> Mapping[str, float]:
        return {"lag_um": self.leaves}

    def late_s(self, um_per_v: float) -> float:
        return abs(self["lag_um"]) / max(um_per_v * REFERENCE_V_PER_S, 1e-30)

    @property
    def passes(self) -> bool:
        """The lag hardly depends on the displacement."""
        return True

    @property
    def moves_sliders(self) -> bool:
        return self.widens or self.stretches

    def seen_by_sliders(self, signal: Signal, branches: Branches) -> FloatArray:
        from piezo_rig.chain.backlash import behind_each

        if not self.widens:
            return signal.drive_v
        drive = np.ascontiguousarray(signal.drive_v)
        width = self.widens_by_v(branches) * np.abs(self._drag(self._rate(signal)))
        return behind_each(signal.begins, drive, width)

    def wider_by(self, signal: Signal) -> Wider | None:
        if not self.stretches:
            return None
        rate = self._rate(signal)
        still = signal.of_drive.get(
            (self.id, "still", self.window), lambda: self._still_v(signal, rate)
        )
        return Wider(self.at_reference * np.abs(self._drag(rate)), still)

    def _still_v(self, signal: Signal, rate: FloatArray) -> FloatArray:
        """The drive where the rate changed its sign before a sample, else NaN; (n,).

        Where the drive goes straight, the rate goes to its slope within the window.
        """
        still = np.full(rate.size, np.nan)
        turned = 1 + np.flatnonzero(rate[:-1] * rate[1:] < 0.0)
        turned = turned[~np.isin(turned, signal.begins)]
        step_s = signal.time_s[turned] - signal.time_s[turned - 1]
        step_v = signal.drive_v[turned] - signal.drive_v[turned - 1]
        slope = step_v / step_s / REFERENCE_V_PER_S
        after_s = self.window * np.log1p(-rate[turned - 1] / slope)
        still[turned] = signal.drive_v[turned - 1] + step_v * np.clip(after_s / step_s, 0.0, 1.0)
        return still

    @property
    def at_reference(self) -> float:
        """Share by which thresholds are wider at `REFERENCE_V_PER_S`; of the last form."""
        if "opens_um" not in self.parameters:
            raise InputError(
                "model-stage", "stage rate-dependence: opens_um is missing",
                "the model file was written by hand", "give it, or identify the model again",
            )
        return self["lag_um"] / self["opens_um"]

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
        if self.moves_sliders:
            return signal
        numbers = (self["lag_um"], self.growth, self.window, self.settles)
        lag = signal.of_drive.get((self.id, *numbers), lambda: self._lag(signal))
        return signal.with_displacement(signal.displacement_um - lag)

    def _lag(self, signal: Signal) -> FloatArray:
        size = signal.of_drive.get(
            (self.id, "size", self.growth, self.window, self.settles),
            lambda: self._settled(signal) if self.settles else self._drag(self._rate(signal)),
        )
        return np.asarray(self["lag_um"] * size)

    def _drag(self, rate: FloatArray) -> FloatArray:
        size, grows = np.abs(rate), self.growth
        if grows < 0.0:
            size = np.log1p(-grows * size) / np.log1p(-grows)
        else:
            size = size**grows
        return np.asarray(np.sign(rate) * size)

    @property
    def growth(self) -> float:
        """The exponent; of a lag that levels off instead the speeds, of that at which it begins to,
        in `REFERENCE_V_PER_S`, with the other sign.
        """
        if self.parameters.get("levels_off", NONE).value != 1.0:
            return self["exponent"]
        return -_times_beyond(self["exponent"])

    def _settled(self, signal: Signal) -> FloatArray:
        """The drag of what the drive does between samples, settling within the window; (n,)."""
        from piezo_rig.chain.relaxation import off_each

        time = np.ascontiguousarray(signal.time_s)
        steps = np.maximum(np.diff(time), 1e-12)
        rate = np.diff(signal.drive_v) / steps / REFERENCE_V_PER_S
        rate[signal.begins[1:] - 1] = 0.0  # from one drive to the next
        whole = np.concatenate([[0.0], np.cumsum(self._drag(rate) * steps)])
        return np.asarray(-off_each(signal.begins, time, whole, self.window) / self.window)

    def usual(self) -> Stage:
        return self.with_values(
            exponent=self.neutral["exponent"], window_s=USUAL_S, widens=0.0, settles=0.0
        )

    def otherwise(self) -> list[Stage]:
        usual = {"exponent": self.neutral["exponent"], "window_s": USUAL_S}
        if self.moves_sliders:
            return [self.with_values(widens=0.0, settles=s, **usual) for s in (0.0, 1.0)]
        return [self.with_values(settles=0.0 if self.settles else 1.0),
                self.with_values(widens=1.0, **usual)]  # fmt: skip

    def shapes(self) -> dict[str, list[Stage]]:
        return {
            f"{widens:g}, {levels:g}": [
                self.with_values(widens=widens, levels_off=levels, settles=0.0, exponent=e,
                                 window_s=w)
                for e in exponents for w in SHAPE_WINDOWS_S
            ]
            for widens in self._forms for levels, exponents in enumerate(SHAPE_EXPONENTS)
        }  # fmt: skip

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
            for widens in self._forms for exponent in LARGE_EXPONENTS for times in LARGE_TIMES
            for window_s in WINDOWS_S[1:]
        ]  # fmt: skip

    def increment(self, branches: Branches) -> Increment | str:
        rest = (self.growth, self.window, REFERENCE_V_PER_S)
        if self.stretches:
            thresholds, weights = sliders(branches)
            return Increment(Operation.STRETCH, (
                self.at_reference, *rest, float(thresholds.size), *thresholds, *weights,
            ))  # fmt: skip
        if self.widens:
            return Increment(Operation.WIDEN, (self.widens_by_v(branches), *rest))
        return Increment(Operation.DRAG, (self["lag_um"], *rest, float(self.settles)))

    @property
    def _forms(self) -> tuple[float, ...]:
        """What ``widens`` may be."""
        return (0.0, 1.0, 2.0) if "opens_um" in self.parameters else (0.0, 1.0)

    @property
    def widens(self) -> bool:
        """Thresholds widen by the same volts."""
        return self.parameters.get("widens", NONE).value == 1.0

    @property
    def stretches(self) -> bool:
        """Thresholds widen by the same share of themselves."""
        return self.parameters.get("widens", NONE).value == 2.0

    @property
    def settles(self) -> bool:
        return bool(self.parameters.get("settles", NONE).value) and not self.moves_sliders

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
        size, branches = 3e-4 * context.travel_um, context.model.branches()
        um_per_v, opens_um = _mean_compliance(branches), _behind_um(branches)
        forms = (0.0, 1.0, 2.0) if opens_um > 0.0 else (0.0, 1.0)
        fine = context.seen_hz * AT_ONCE_S >= FINE
        return [
            [cls.of(None, lag_um=size / speed**e, exponent=e, window_s=w, widens=s,
                    um_per_v=um_per_v, opens_um=opens_um)
             for e in (LOW, HIGH)]
            for s in forms for w in ((AT_ONCE_S, *WINDOWS_S) if fine or s == 2.0 else WINDOWS_S)
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


@cache
def _times_beyond(exponent: float) -> float:
    """x at which log(1 + x) grows with the power ``exponent`` of x; below 1."""
    wanted, low, high = float(np.clip(exponent, *LEVELS)), -20.0, 60.0
    for _ in range(HALVED):  # of the logarithm of x
        x = np.exp(0.5 * (low + high))
        if x / (1.0 + x) > wanted * np.log1p(x):
            low = np.log(x)
        else:
            high = np.log(x)
    return float(np.exp(low))


def _behind_um(branches: Branches) -> float:
    """By how much all sliders together are behind where all give way, um."""
    thresholds, weights = sliders(branches)
    return float(thresholds @ weights)


def _mean_compliance(branches: Branches) -> float:
    """Of all sliders together, um/V."""
    rest = branches.rest
    volts = np.diff(rest.knots_v, prepend=0.0)
    moved = float(volts @ rest.compliance_um_per_v[: volts.size])
    return float(moved / rest.knots_v[-1] if moved else rest.compliance_um_per_v[-1])
