"""Noise that switches between two levels: a loose contact, a charge trapped and let go of.

Such a telegraph signal comes at random, so repeats disagree by it and all of it counts as noise;
its steps, taken one by one, look like lost samples or small jumps of the interferometer. Steps of
one size, up as often as down, many of them and away from turning points, are neither; nor do they
go like the drive's acceleration, as what lost samples leave of a smooth one does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from piezo_rig.diagnosis.groups import Groups

FloatArray = NDArray[np.float64]
OVER_S = (0.002, 0.005, 0.01, 0.02, 0.04)  # averaged before steps are looked for
SHORTEST = 3  # samples of such an average
STANDS_OUT = 4.5  # standard deviations of what the averages usually change by
USUAL = 0.6745  # standard deviations that half of normal numbers stay within
LEAST = 20  # steps
ALIKE = 0.15  # of their size, by which half of the steps may be off it
UNEVEN = 3.0  # standard deviations, of a fair coin, between steps up and down
BY_CHANCE = 0.003  # of a fair coin, that as many go with the drive or against it
BESIDE_S = 0.03  # of turning points: what many lost samples do there lasts as long as they did
MOST = 0.25  # of all averages that may be steps: else nothing is usual
FRINGE_UM, OFF = 0.0791, 0.04  # a jump of the interferometer; how near to a whole number of them


@dataclass(frozen=True)
class Levels:
    """``count`` steps of ``step_nm`` between two levels, so many a second of one recording."""

    count: int
    step_nm: float
    per_second: float

    @property
    def rms_nm(self) -> float:
        """What it adds to a recording that is half of the time at each."""
        return 0.5 * self.step_nm

    @property
    def text(self) -> str:
        return (
            f"the noise switches between two levels, {self.step_nm:.3g} nm apart, "
            f"about {self.per_second:.2g} times a second: a loose contact, or the sensor's own"
        )


def levels(groups: Groups) -> Levels | None:
    """What steps there are between the repeats of one drive; None where they are of no one kind.

    Clean of spikes; what a single recording has of them is not known without repeats.
    """
    best: Levels | None = None
    for seconds in OVER_S:
        width = round(seconds * groups.rate)
        if width < SHORTEST:
            continue
        changes = _changes(groups, width)
        found = _alike(changes, width / groups.rate)
        if found is not None and (best is None or found.count > best.count):
            best = found
    return best


def _changes(groups: Groups, width: int) -> list[tuple[FloatArray, FloatArray]]:
    """From each average of so many samples to the next but one, of what two repeats differ by.

    Only away from turning points: a lost sample turns over at every one of them. With each the
    second difference of the drive there.
    """
    out = []
    for group in groups.groups:
        for a, b in group.blocks:
            count = (b - a) // width
            if group.repeats < 2 or count < LEAST:
                continue
            apart = np.diff(group.measured_um[:, a : a + count * width], axis=0)
            means = apart.reshape(len(apart), count, width).mean(axis=2)
            begins = a + width * np.arange(count - 2)
            turns = np.sort(np.append(group.loops.start, group.loops.stop))
            beside = max(width, round(BESIDE_S * groups.rate))
            first = np.searchsorted(turns, begins - beside, side="right")
            near = first < np.searchsorted(turns, begins + 3 * width + beside)
            drive = group.drive_v[a : a + count * width].reshape(count, width).mean(axis=1)
            bends = np.diff(drive, 2)
            out += [(np.where(near, np.nan, row), bends) for row in means[:, 2:] - means[:, :-2]]
    return out


def _alike(changes: list[tuple[FloatArray, FloatArray]], step_s: float) -> Levels | None:
    if not changes:
        return None
    every = np.concatenate([row for row, _ in changes])
    every = every[np.isfinite(every)]
    if not every.size:
        return None
    usual = float(np.median(np.abs(every - np.median(every)))) / USUAL
    if not usual > 0.0:
        return None
    steps = [_steps(row, STANDS_OUT * usual) for row, _ in changes]
    sizes = np.concatenate([row[at] for (row, _), at in zip(changes, steps, strict=True)])
    if sizes.size < LEAST or sizes.size > MOST * every.size:
        return None
    size = float(np.median(np.abs(sizes)))
    off = float(np.median(np.abs(np.abs(sizes) - size)))
    uneven = abs(float(np.sum(np.sign(sizes)))) / np.sqrt(sizes.size)
    driven = [np.sign(row[at] * bends[at]) for (row, bends), at in zip(changes, steps, strict=True)]
    fringes = size / FRINGE_UM
    if off > ALIKE * size or uneven > UNEVEN or _with_the_drive(driven):
        return None
    if abs(fringes - round(fringes)) < OFF * fringes:
        return None
    seconds = step_s * every.size  # what is left of two recordings
    return Levels(int(sizes.size), 1e3 * size, 0.5 * sizes.size / seconds)


def _with_the_drive(driven: list[FloatArray]) -> bool:
    """Whether steps go as the drive bends, or against it, more than a fair coin would have it.

    Of every two recordings by themselves: it is either's samples that may be lost.
    """
    told = [d for d in driven if d.size]
    square = sum(float(d.sum()) ** 2 / d.size for d in told)
    return bool(told) and float(chdtrc(len(told), square)) < BY_CHANCE


def _steps(row: FloatArray, least: float) -> NDArray[np.int64]:
    """Where the largest change of every stretch of changes that stand out is."""
    loud = np.abs(row) > least
    edges = np.flatnonzero(np.diff(np.concatenate([[0], loud.astype(int), [0]])))
    return np.array([
        a + np.argmax(np.abs(row[a:b])) for a, b in zip(edges[::2], edges[1::2], strict=True)
    ], int)  # fmt: skip
