"""A target and a rig's limits in, a drive out, with what became of every stage.

A virgin actuator at the rig's rest stands at 0 um, and that is where a target begins. From there
on the drive of every sample is the one that brings the model's displacement to the target, given
what the model remembers; it never looks ahead, but by the delay of the record, which is known.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.chain.half_loops import SMALL, dead_band, half_loops
from piezo_rig.compensation.small_reversals import Waits, doubtful
from piezo_rig.compensation.stages import Treatment, treat
from piezo_rig.compensation.stepper import Bounds, OutOfReach, Stepper
from piezo_rig.compensation.tables import ROUNDING_V
from piezo_rig.config import Rig
from piezo_rig.errors import InputError, LimitError
from piezo_rig.protocol.plan import REST_DRIVE_V

FloatArray = NDArray[np.float64]
FEWEST = 2
ROUNDS = 4  # a drive that waits goes back a little less, or elsewhere
AT_ZERO_UM = 1e-3


@dataclass(frozen=True, eq=False)
class Target:
    """Where the actuator shall be: ``time_s`` and ``displacement_um`` of shape (n,)."""

    time_s: FloatArray
    displacement_um: FloatArray
    name: str = "target"

    def check(self) -> None:
        """Refuse what no actuator could be asked for.

        Raises
        ------
        InputError : too few rows, time that does not grow, a gap, a beginning away from 0
        """
        time, um = self.time_s, self.displacement_um
        if time.size < FEWEST:
            raise InputError("target-short", f"{self.name}: {time.size} rows",
                             "a target needs a beginning and somewhere to go",
                             f"give at least {FEWEST} rows")
        for values, word in ((time, "time_s"), (um, "displacement_um")):
            for bad, what, cause, remedy in (
                (np.isnan(values), "not a number", "a gap in the file", "fill the gap"),
                (np.isinf(values), "infinite", "what wrote the file divided by zero, or the number "
                 "is too large to be kept", "give a finite number"),
            ):  # fmt: skip
                if bad.any():
                    raise InputError("not-a-number",
                                     f"{self.name}: {word} is {what} at sample {bad.argmax()} "
                                     f"({bad.sum()} in all)", cause, remedy)
        late = np.flatnonzero(~(np.diff(time) > 0.0))
        if late.size:
            k = int(late[0]) + 1
            raise InputError("time-order",
                             f"{self.name}: time_s goes from {time[k - 1]:.9g} to {time[k]:.9g} s "
                             f"at sample {k}", "rows are out of order, or given twice",
                             "let time grow from row to row")
        if abs(um[0]) > AT_ZERO_UM:
            raise InputError("target-start",
                             f"{self.name}: the target begins at {um[0]:.6g} um",
                             "a virgin actuator stands at 0 um when it begins",
                             "let the target begin at 0 and go to its first value from there")


@dataclass(frozen=True, eq=False)
class Compensation:
    """What `compensate` gives.

    Attributes
    ----------
    drive_v : shape (n,), one for every sample of the target
    predicted_um : shape (n,), what the whole model makes of it: as its record shows it, or of its
        free end
    lead_s : how much ahead of the record the drive is
    treatments : what became of every stage
    warnings : what the user should know of the target
    """

    drive_v: FloatArray
    predicted_um: FloatArray
    lead_s: float
    treatments: list[Treatment]
    warnings: list[str]


def bounds_of(rig: Rig) -> Bounds:
    """Where a rig lets the drive go: its limits, its command's, and its amplifier's current."""
    limits, stack = rig.limits, rig.actuator
    farad = stack.capacitance_f * stack.large_signal_factor
    ends = sorted(rig.gain * v + rig.offset_v for v in (rig.command_min_v, rig.command_max_v))
    return Bounds(
        max(limits.drive_min_v, ends[0]), min(limits.drive_max_v, ends[1]),
        min(limits.slew_v_per_s, limits.current_a / farad),
    )


def compensate(
    model: Model, target: Target, bounds: Bounds, free_end: bool = False
) -> Compensation:
    """The drive that brings a virgin actuator along a target.

    Parameters
    ----------
    model : as `identify` or `diagnose` wrote it
    target : begins at 0 um
    bounds : of the drive
    free_end : the actuator itself is in time, not its record

    Raises
    ------
    InputError : a target that cannot be asked for, or a model that cannot be inverted
    LimitError : the target is out of reach; names the sample
    """
    target.check()
    time = target.time_s
    kept, lead_s, treatments = treat(model, float(np.median(np.diff(time))), free_end)
    wanted = target.displacement_um
    if lead_s:
        wanted = np.interp(time + lead_s, time, wanted)
    first = _first_drive(kept, bounds)

    def followed(dead_band_v: float, waits: Waits | None = None) -> FloatArray:
        stepper = Stepper(kept, True, dead_band_v)
        stepper.begin(time[0], first)
        later = Waits(waits.low_v[1:], waits.high_v[1:]) if waits else None
        try:
            return np.append(first, stepper.follow(time[1:], wanted[1:], bounds, later))
        except OutOfReach as reach:
            raise _out_of_reach(reach, target, wanted, bounds) from None

    span_v = bounds.high_v - bounds.low_v
    least = SMALL * span_v if np.isfinite(span_v) else ROUNDING_V
    used = least
    drive = followed(used)
    band = dead_band(drive)
    own = SMALL * float(np.ptp(drive))
    if band <= least and own < least and _turns(drive, own) != _turns(drive, least):
        used = own  # what is a half loop is then one for `simulate` as well
        drive = followed(used)
        band = dead_band(drive)
    if band > least:
        drive = followed(band)
        warnings = [f"the drive is rough: reversals of it up to {band:.2g} V are taken for noise, "
                    "and are no half loops; a smoother target is followed better"]  # fmt: skip
    else:
        drive, warnings = _waiting(drive, wanted, partial(followed, used))
    predicted = model.simulate(time, drive, free_end=free_end)
    return Compensation(drive, predicted, lead_s, treatments, warnings)


def _waiting(
    drive: FloatArray, wanted_um: FloatArray, followed: Callable[[Waits], FloatArray]
) -> tuple[FloatArray, list[str]]:
    """A drive without reversals of which it is not known what they count for; what to say of it."""
    waits = Waits.none(drive.size)
    for _ in range(ROUNDS):
        more = doubtful(drive, wanted_um)
        if not more.count:
            break
        try:
            drive = followed(waits.joined(more))
        except LimitError:
            break  # who waits comes too late for what follows
        waits = waits.joined(more)
    if not waits.count:
        return drive, []
    return drive, [
        f"where the target does not turn back the drive would, by {waits.largest_v:.2g} V at most; "
        "it waits instead, for whether so little ends a half loop is not known"
    ]


def _turns(drive_v: FloatArray, band_v: float) -> int:
    """Half loops of a drive, reversals up to ``band_v`` left out."""
    return len(half_loops(drive_v, band_v))


def _first_drive(model: Model, bounds: Bounds) -> float:
    """Where the drive begins: at rest, or where the amplifier's lower end lets it."""
    first = min(max(REST_DRIVE_V, bounds.low_v), bounds.high_v)
    clipping, gain = model.stage("drive-clipping"), model.stage("drive-gain")
    if clipping is None:
        return first
    ratio = gain["ratio"] if gain else 1.0
    seen = min(max(ratio * first, clipping["lower"]), clipping["upper"])
    return min(max(seen / ratio, bounds.low_v), bounds.high_v)


def _out_of_reach(
    reach: OutOfReach, target: Target, wanted: FloatArray, bounds: Bounds
) -> LimitError:
    k = reach.sample + 1
    time, asked = target.time_s[k], target.displacement_um[k]
    slew = "" if np.isinf(reach.slew_v_per_s) else f" and {reach.slew_v_per_s:.6g} V/s"
    led = "" if wanted[k] == asked else f" ({wanted[k]:.6g} um with the lead)"
    step_v = reach.slew_v_per_s * (time - target.time_s[k - 1])
    if wanted[k] > reach.most_um and reach.drive_v + step_v >= bounds.high_v:
        cause = "the target is beyond what the highest drive gives"
    elif wanted[k] < min(0.0, reach.least_um) and reach.drive_v - step_v <= bounds.low_v:
        cause = "the target is below what the lowest drive gives"
    elif wanted[k] < reach.least_um and reach.drive_v - step_v <= bounds.low_v:
        cause = ("after its first rise an actuator with hysteresis does not come back to where it "
                 "began, unless the drive goes below where that was")  # fmt: skip
    elif reach.slew_v_per_s < bounds.slew_v_per_s:
        cause = "the target moves faster there than the model's amplifier follows (slew-limit)"
    else:
        cause = "the target moves faster there than the rig lets the drive move"
    return LimitError(
        "out-of-reach",
        f"{target.name}: sample {k} ({time:.6g} s) asks for {asked:.6g} um{led}; within reach "
        f"there are {reach.least_um:.6g} .. {reach.most_um:.6g} um, from {reach.drive_v:.4g} V "
        f"at the sample before, with a drive of {bounds.low_v:g} .. {bounds.high_v:g} V{slew}",
        cause, "keep the target inside, or make it slower there",
    )
