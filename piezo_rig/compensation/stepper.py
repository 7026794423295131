"""A model sample by sample: `Stepper` is the door to the compiled machine.

    stepper = Stepper(model)
    stepper.begin(time_s=0.0, drive_v=0.0)
    um = stepper.play(time_s, drive_v)          # what the model makes of a drive
    volts = stepper.follow(time_s, target_um, limits)   # the drive that makes a target

Both go on from where the one before has stopped, so a signal may come in pieces, or one sample at
a time. What `play` gives is what `Model.simulate` gives of the whole drive, free end, virgin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.compensation.small_reversals import Waits
from piezo_rig.compensation.tables import ROUNDING_V, tables_of
from piezo_rig.errors import InputError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Bounds:
    """Where the drive may go: V, and V/s from sample to sample."""

    low_v: float = -np.inf
    high_v: float = np.inf
    slew_v_per_s: float = np.inf


@dataclass(frozen=True)
class OutOfReach(Exception):
    """A target that no drive within the bounds reaches.

    Attributes
    ----------
    sample : of the piece that was given
    least_um, most_um : what is within reach there, from the sample before
    drive_v : of the sample before
    slew_v_per_s : the fastest that the drive may be, by the bounds or by the model's amplifier
    """

    sample: int
    least_um: float
    most_um: float
    drive_v: float
    slew_v_per_s: float = np.inf


def _fastest_v_per_s(model: Model) -> float:
    """What a model's amplifier can follow of a drive; infinite without a slew limit."""
    limit, gain = model.stage("slew-limit"), model.stage("drive-gain")
    if limit is None:
        return np.inf
    return float(limit["limit"] / (gain["ratio"] if gain else 1.0))


class Stepper:
    """One model and what it remembers.

    Parameters
    ----------
    model : every stage locked to the drive, at drive or actuator, has a form sample by sample
    steady : bound the drag of slow drives, as `follow` needs it
        (docs/decisions/0015-how-a-model-is-inverted.md); leave it out to play what the model is

    dead_band_v : reversals up to that are not counted as half loops: noise

    Raises
    ------
    InputError : a stage has no such form
    """

    def __init__(
        self, model: Model, steady: bool = False, dead_band_v: float = ROUNDING_V
    ) -> None:
        from piezo_rig.compensation import machine

        self._machine = machine
        self.tables = tables_of(model, steady, dead_band_v)
        self.state = machine.new_state(self.tables)
        self._fastest_v_per_s = _fastest_v_per_s(model)
        self._time_s = np.nan

    def begin(self, time_s: float, drive_v: float) -> None:
        """Virgin at a drive, where the displacement is 0."""
        self._machine.start(self.tables, self.state, float(drive_v))
        self._time_s = float(time_s)

    def play(self, time_s: FloatArray, drive_v: FloatArray) -> FloatArray:
        """Displacement (n,), um, of samples after the last one.

        Raises
        ------
        InputError : time does not go on, or a law of the first spring ends in a negative slope
        """
        time, drive, out = self._joined(time_s, drive_v)
        k = 1
        while k < drive.size:
            k, why = self._machine.play(self.tables, self.state, time, drive, out, k)
            self._heed(why, k)
        self._time_s = float(time[-1])
        return out[1:]

    def follow(
        self, time_s: FloatArray, target_um: FloatArray, bounds: Bounds,
        waits: Waits | None = None,
    ) -> FloatArray:  # fmt: skip
        """The drive (n,), V, whose displacement is the target's, sample after sample.

        It is never faster than the model's amplifier: ahead of that, it could not come back.

        ``waits`` : where it stays, of samples (n,), though the target goes on

        Raises
        ------
        OutOfReach : no drive within the bounds gets there
        InputError : as in `play`
        """
        time, target, drive = self._joined(time_s, target_um)
        waits = waits or Waits.none(target.size - 1)
        low, high = (np.concatenate([[0.0], v]) for v in (waits.low_v, waits.high_v))
        slew = min(bounds.slew_v_per_s, self._fastest_v_per_s)
        reach = np.empty(2)
        k = 1
        while k < target.size:
            k, why = self._machine.follow(
                self.tables, self.state, time, target, bounds.low_v, bounds.high_v,
                slew, low, high, drive, k, reach,
            )  # fmt: skip
            if why == self._machine.OUT_OF_REACH:
                before = float(self.state.scalars[self._machine.DRIVE])
                raise OutOfReach(k - 1, float(reach.min()), float(reach.max()), before, slew)
            self._heed(why, k)
        self._time_s = float(time[-1])
        return drive[1:]

    def _joined(
        self, time_s: FloatArray, given: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Time with the last one before it, what is given in step with it, and room for more."""
        time = np.concatenate([[self._time_s], np.asarray(time_s, float)])
        if not np.all(np.diff(time) > 0.0):
            raise InputError("time-order", "time does not grow from sample to sample",
                             "nothing was begun, or rows are out of order", "sort the rows")
        values = np.concatenate([[0.0], np.asarray(given, float)])
        if values.size != time.size or not np.all(np.isfinite(values)):
            raise InputError("not-a-number", "a value is missing or is not a number",
                             "a gap in the file", "fill the gap")
        return time, values, np.empty(time.size)

    def _heed(self, why: int, k: int) -> None:
        """Make room for more turning points, or refuse a branch that cannot be."""
        if why == self._machine.NO_ROOM:
            self.state = self._machine.with_room(self.state, 2 * self.state.turn.size)
        elif why == self._machine.BAD_SLOPE:
            raise InputError(
                "slope-not-positive",
                f"the first slope of the half loop that begins at sample {k - 1} is not above 0",
                "the law of the first spring does not hold for this drive",
                "use the model inside the range that it was identified on",
            )
