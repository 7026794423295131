"""The residual of every rung, sample by sample, with what it may depend on; and its means in bins.

The mean over the repeats of a drive for what is locked to the drive, single recordings for what is
locked to the clock. Every block has its own free offset, as everywhere in a diagnosis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.diagnosis.groups import Group, Groups
from piezo_rig.diagnosis.isolability import Workings
from piezo_rig.diagnosis.refit import refit
from piezo_rig.errors import InputError

FloatArray = NDArray[np.float64]
FEWEST = 2  # half loops for a standard error


@dataclass(frozen=True, eq=False)
class Samples:
    """What the samples of one group are like, over its blocks; every array of shape (n,).

    ``loop`` numbers the half loops of the group.
    """

    group: Group

    @cached_property
    def taken(self) -> NDArray[np.int64]:
        return np.concatenate([np.arange(a, b) for a, b in self.group.blocks])

    @cached_property
    def loop(self) -> NDArray[np.int64]:
        starts = self.group.loops.start
        return np.maximum(np.searchsorted(starts, self.taken, side="right") - 1, 0)

    @property
    def time_s(self) -> FloatArray:
        return self.group.time_s[self.taken] - self.group.time_s[0]

    @property
    def drive_v(self) -> FloatArray:
        return self.group.drive_v[self.taken]

    @property
    def displacement_um(self) -> FloatArray:
        return np.asarray(self.group.measured_um.mean(axis=0)[self.taken])

    @property
    def since_turn_s(self) -> FloatArray:
        return self.group.time_s[self.taken] - self.group.time_s[self.group.loops.start][self.loop]

    @property
    def change_v(self) -> FloatArray:
        """How far the drive has come since the turning point."""
        return np.abs(self.drive_v - self.group.loops.extremum_v[self.loop])

    @property
    def cycle(self) -> FloatArray:
        """Cycles since the recording began."""
        return np.asarray(0.5 * self.loop)

    @property
    def direction(self) -> FloatArray:
        return self.group.loops.direction[self.loop]

    @property
    def range_v(self) -> FloatArray:
        return self.group.loops.range_v[self.loop]

    @property
    def extremum_v(self) -> FloatArray:
        return self.group.loops.extremum_v[self.loop]

    @property
    def speed_v_per_s(self) -> FloatArray:
        """Mean |dV/dt| of the half loop."""
        loops, time = self.group.loops, self.group.time_s
        seconds = np.maximum(time[loops.stop] - time[loops.start], 1e-9)
        volts = np.abs(self.group.drive_v[loops.stop] - self.group.drive_v[loops.start])
        return np.asarray((volts / seconds)[self.loop])

    @property
    def first_rise(self) -> NDArray[np.bool_]:
        """Where a rested actuator is driven further than ever before."""
        if not self.group.virgin:
            return np.zeros(self.taken.size, bool)
        return np.asarray(self.loop == 0)


class Residuals:
    """Residuals (nm) of every rung; what was computed once is kept."""

    def __init__(self, workings: Workings, models: Sequence[Model]) -> None:
        self.rungs = min(len(models), len(workings.groups))
        self.groups: list[Groups] = list(workings.groups[: self.rungs])
        self.models = list(models[: self.rungs])
        self._workings = workings
        self._known: dict[tuple[str, int], tuple[int, int]] = {}
        self.samples = [Samples(g) for g in workings.groups[0].groups]
        self._predicted: dict[tuple[int, int], FloatArray] = {}
        self._mean: dict[tuple[int, int], FloatArray] = {}

    def but_for(self, cause: str, rung: int) -> tuple[int, int]:
        """Where the residuals of everything but a cause are, and those of everything.

        Without it all that is left of the last model is fitted anew: what shows is what nothing
        else can do. A cause that is no stage is put back into the recordings. ``rung`` : its own
        """
        key = (cause, rung)
        if key not in self._known:
            last, point = self.rungs - 1, self._workings.last.point
            groups, models = [self.groups[last]] * 2, [self.models[last]] * 2
            if point.model.stage(cause) is None:
                groups = [self.groups[rung - 1], self.groups[rung]]
            else:
                less = _without(self._workings, cause)
                if less is None:
                    return rung - 1, rung
                models[0] = less
            at = len(self.groups)
            self.groups += groups
            self.models += models
            self._known[key] = at, at + 1
        return self._known[key]

    def mean(self, rung: int, index: int) -> FloatArray:
        """Residual of a group's mean over its repeats, shape (n,), in the order of `samples`."""
        if (rung, index) not in self._mean:
            rows = self.groups[rung].groups[index].measured_um
            self._mean[rung, index] = self._left(rung, index, rows.mean(axis=0))
        return self._mean[rung, index]

    def single(self, rung: int, index: int) -> FloatArray:
        """Residuals of a group's recordings, shape (R, n)."""
        rows = self.groups[rung].groups[index].measured_um
        return np.array([self._left(rung, index, row) for row in rows])

    def own(self, rung: int, index: int) -> FloatArray:
        """What a group's recordings have of their own, shape (R, n).

        Against the mean of the other recordings; of one alone, against the model.
        """
        rows = self.single(rung, index)
        count = rows.shape[0]
        return rows if count < 2 else (rows - rows.mean(axis=0)) * (count / (count - 1.0))

    def _left(self, rung: int, index: int, row: FloatArray) -> FloatArray:
        group = self.groups[rung].groups[index]
        key = (id(self.models[rung]), index)  # early rungs share their model
        if key not in self._predicted:
            self._predicted[key] = group.predicted(self.models[rung])
        off = row - self._predicted[key]
        return 1e3 * np.concatenate([off[a:b] - off[a:b].mean() for a, b in group.blocks])


def _without(workings: Workings, cause: str) -> Model | None:
    """The last model without a cause, fitted anew; None where there is none that can be played."""
    try:
        less = refit(workings.space, workings.last.point.without(cause), held=True)
    except (InputError, np.linalg.LinAlgError):
        return None
    return less.point.model


@dataclass(frozen=True, eq=False)
class Binned:
    """Means in bins: all of shape (k,), empty bins left out; ``error`` NaN where it is unknown.

    ``units`` : how many half loops a bin holds
    """

    x: FloatArray
    mean: FloatArray
    error: FloatArray
    low: FloatArray
    high: FloatArray
    units: FloatArray


def binned(
    parts: Sequence[tuple[FloatArray, FloatArray, NDArray[np.int64]]], edges: FloatArray
) -> Binned:
    """Means of y over x, with the standard error from half loop to half loop.

    Samples of one half loop are not independent of each other; half loops nearly are.

    Parameters
    ----------
    parts : x, y and the number of the half loop, one tuple to a group
    edges : shape (k + 1,)
    """
    k = edges.size - 1
    sums, squares, units = np.zeros(k), np.zeros(k), np.zeros(k)
    middle, samples = np.zeros(k), np.zeros(k)
    low, high = np.full(k, np.inf), np.full(k, -np.inf)
    for x, y, loop in parts:
        if x.size == 0:
            continue
        bin = np.searchsorted(edges, x, side="right") - 1
        bin[x == edges[-1]] = k - 1
        inside = (bin >= 0) & (bin < k)
        bin, x, y, loop = bin[inside], x[inside], y[inside], loop[inside]
        if x.size == 0:
            continue
        cell = bin + k * (loop - loop.min())
        count = np.bincount(cell)
        used = np.flatnonzero(count)
        means = np.bincount(cell, y)[used] / count[used]
        np.add.at(sums, used % k, means)
        np.add.at(squares, used % k, means**2)
        np.add.at(units, used % k, 1.0)
        middle += np.bincount(bin, x, k)
        samples += np.bincount(bin, minlength=k)
        np.minimum.at(low, bin, y)
        np.maximum.at(high, bin, y)
    good = units > 0
    n = np.maximum(units, 1.0)
    mean = sums / n
    spread = np.maximum(squares / n - mean**2, 0.0)
    error = np.where(n >= FEWEST, np.sqrt(spread / np.maximum(n - 1.0, 1.0)), np.nan)
    x = middle / np.maximum(samples, 1.0)
    return Binned(x[good], mean[good], error[good], low[good], high[good], units[good])
