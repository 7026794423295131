"""Outliers: found first, at full rate, in single recordings, and left out of everything after."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Model, Parameter, Stage
from piezo_rig.diagnosis.chances import chi2_at, normal_above, poisson_above
from piezo_rig.diagnosis.groups import Group, Groups
from piezo_rig.diagnosis.masks import runs

FloatArray = NDArray[np.float64]
FAR, NEARER = 8.0, 5.5  # robust standard deviations: of the first, and where there are some
SHARP = 0.5  # of a spike's height between neighbouring samples, on both sides
BACK, NOISY = 0.35, 3.0  # of its height that a spike may leave behind; standard deviations, if more
ON = 0.5  # of a step that the one before it may go the same way
TURNS = 2  # in which smaller ones are looked for beside those that are known
NEAR = 41  # samples whose scatter a spike must stand out of
OF_TURNS = 2e-3  # chance of so many spikes at turning points, below which they are no accidents
LONGEST = 5  # samples; what lasts longer is no spike
MANY, LEAP = 400, 0.5  # samples at one speed; of what a model moves, where there are fewer
MOST = 0.02  # of all samples
BY_CHANCE = 0.1  # of the spikes may be noise
SMALLEST = 1e-5  # of the travel


@dataclass(frozen=True)
class Spike:
    """One spike of one recording.

    Attributes
    ----------
    group, row : the recording
    index : its first sample, ``low`` and ``high`` as well: it is certain
    height_nm : of its largest sample, off the neighbours
    """

    group: int
    row: int
    index: int
    height_nm: float

    @property
    def low(self) -> int:
        return self.index

    @property
    def high(self) -> int:
        return self.index


@dataclass(frozen=True, eq=False)
class Spikes:
    """What was found, and the recordings without it."""

    groups: Groups
    spikes: tuple[Spike, ...]
    seconds: float
    p_value: float

    def stage(self) -> Stage:
        count = len(self.spikes)
        rate = count / self.seconds
        low = chi2_at(0.975, 2 * count) / 2.0 / self.seconds if count else 0.0
        high = chi2_at(0.025, 2 * count + 2) / 2.0 / self.seconds
        kind = CAUSES["outliers"]
        return kind({"per_second": Parameter(rate, "1/s", (float(low), float(high)))})


def find_spikes(groups: Groups, model: Model) -> Spikes:
    """Samples that stand far off their neighbours on both sides, against a model's prediction.

    A first one has to stand out of everything. Where there are such, what stands out of its
    surroundings alone is one as well: a rate that counts the tall ones only is too low. How far
    samples scatter is seen without those that are known.
    """
    first = found = _found(groups, model, FAR)
    for _ in range(TURNS):
        if not found.spikes:
            break
        every = _found(groups, model, NEARER, found.groups)
        if not _credible(every, groups):
            break
        found = replace(every, p_value=first.p_value)
    return found


def _credible(found: Spikes, groups: Groups) -> bool:
    """Whether few of the spikes can be noise."""
    samples = sum(g.measured_um.size for g in groups.groups)
    return samples * 2.0 * normal_above(NEARER) < BY_CHANCE * len(found.spikes)


def _found(groups: Groups, model: Model, far: float, quiet: Groups | None = None) -> Spikes:
    """All that stand out by so many standard deviations.

    ``quiet`` : the recordings without those that are known
    """
    cleaned, spikes, seconds, samples = [], list[Spike](), 0.0, 0
    for g, (group, known) in enumerate(zip(groups.groups, (quiet or groups).groups, strict=True)):
        predicted = group.predicted(model)
        speed = _speed(predicted) if group.repeats == 1 else None
        marks = _marked(group, known.measured_um, predicted, groups.travel_um, far, speed)
        if marks.any():  # what turning points show, one after the other, is no accident
            lower = _marked(  # of which not all may be tall
                group, known.measured_um, predicted, groups.travel_um, min(far, NEARER), speed
            )
            marks &= ~np.array([_at_turns(group, mark) for mark in lower])
        rows = []
        for r, (row, mark) in enumerate(zip(group.measured_um, marks, strict=True)):
            found = runs(mark)
            off = _off(row - predicted) if found else row
            spikes += [Spike(g, r, a, 1e3 * float(max(off[a:b], key=abs))) for a, b in found]
            rows.append(_filled(row, predicted, mark) if found else row)
        cleaned.append(group.with_measured(np.array(rows)))
        seconds += group.repeats * float(group.time_s[-1] - group.time_s[0])
        samples += group.measured_um.size
    chance, count = samples * 2.0 * normal_above(far), len(spikes)
    p = poisson_above(count - 1, max(chance, 1e-6)) if count else 1.0
    if count == 0:
        return Spikes(groups, (), seconds, 1.0)
    return Spikes(groups.with_(cleaned), tuple(spikes), seconds, max(p, 1e-12))


def _marked(
    group: Group, usual: FloatArray, predicted: FloatArray, travel_um: float, far: float,
    speed: FloatArray | None,
) -> NDArray[np.bool_]:
    """What stands out in each recording of a group (k, n), but for what every repeat shows at the
    same place: that is no accident.
    """
    marks = np.array([
        _marks(row - predicted, calm - predicted, travel_um, far, speed)
        for row, calm in zip(group.measured_um, usual, strict=True)
    ])
    if group.repeats > 1:
        marks &= np.array([_alone(group.measured_um, usual, k, far) for k in range(group.repeats)])
    return marks


def _off(values: FloatArray) -> FloatArray:
    """What samples stand off their neighbours."""
    return values - ndimage.median_filter(values, 2 * LONGEST + 1, mode="nearest")


def _speed(predicted: FloatArray) -> FloatArray:
    """The largest change from one sample to the next near each sample, shape (n,)."""
    change = np.abs(np.diff(predicted, prepend=predicted[:1]))
    return np.asarray(ndimage.maximum_filter1d(change, 2 * LONGEST + 1, mode="nearest"))


def _at_speed(off: FloatArray, speed: FloatArray, far: float) -> FloatArray:
    """Standard deviations (n,) of what a model does badly at about a sample's speed.

    Where the drive leaps, a model that is wrong by a share is wrong at once, for some samples.
    """
    out = np.zeros_like(off)
    octave = np.floor(np.log2(np.maximum(speed, 1e-12)))
    for which in np.unique(octave):
        here = octave == which
        few = off[here]
        if few.size < MANY:
            out[here] = LEAP * speed[here] / far
        else:
            spread = (np.percentile(few, 99) - np.percentile(few, 1)) / 4.65
            out[here] = max(1.4826 * float(np.median(np.abs(few))), float(spread))
    return out


def _marks(
    residual: FloatArray, usual: FloatArray, travel_um: float, far: float,
    speed: FloatArray | None,
) -> NDArray[np.bool_]:
    """
    Parameters
    ----------
    usual : the residual without spikes that are known
    speed : of the prediction, where there is nothing else to tell a model's errors by
    """
    off, calm = _off(residual), _off(usual)
    sigma = 1.4826 * float(np.median(np.abs(calm)))
    # heavy tails and slow noise must not pass for spikes
    spread = (np.percentile(calm, 99) - np.percentile(calm, 1)) / 4.65
    # nor must a stretch that the model does badly, where each step of the drive shows
    local = 1.4826 * ndimage.median_filter(np.abs(calm), NEAR, mode="nearest")
    least = np.maximum(local, max(sigma, float(spread), SMALLEST * travel_um))
    if speed is not None:
        least = np.maximum(least, _at_speed(calm, speed, far))
    mark = np.abs(off) > far * least
    mark[:2] = mark[-2:] = False
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mark.astype(np.int8), [0]])))
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        if b - a > LONGEST or not _sharp(residual, off, least, int(a), int(b)):
            mark[a:b] = False
    return mark if mark.mean() < MOST else np.zeros_like(mark)


def _sharp(residual: FloatArray, off: FloatArray, least: FloatArray, a: int, b: int) -> bool:
    """Whether samples a..b - 1 leave their neighbours and come back at once, as no model's error.

    A break point that a model has in the wrong place makes a hump of some samples. So does the
    crest of a wave: up to it samples rise, and after it they fall, as they do further off.
    """
    height = float(np.max(np.abs(off[a:b])))
    up, down = residual[a] - residual[a - 1], residual[b] - residual[b - 1]
    back = abs(residual[b] - residual[a - 1])
    most = max(BACK * height, NOISY * float(np.max(least[a:b])))
    if min(abs(up), abs(down)) <= SHARP * height or back >= most:
        return False
    before, after = residual[a - 1] - residual[a - 2], residual[b + 1] - residual[b]
    return bool(before / up < ON or after / down < ON)


def _alone(
    rows: FloatArray, usual: FloatArray, k: int, far: float
) -> NDArray[np.bool_]:
    """Where recording k stands off the mean of the others as well; these without what is known."""
    others = np.delete(usual, k, axis=0).mean(axis=0)
    off, calm = _off(rows[k] - others), _off(usual[k] - others)
    sigma = 1.4826 * float(np.median(np.abs(calm)))
    # a coarse sensor repeats itself exactly most of the time
    spread = (np.percentile(calm, 99) - np.percentile(calm, 1)) / 4.65
    return np.asarray(np.abs(off) > 0.75 * far * max(sigma, float(spread)))


def _at_turns(group: Group, mark: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Events at turning points, where more of them are there than accidents would be.

    A clipped corner of a fast drive is one sample that stands off: it is the drive's doing.
    """
    turns = np.zeros(mark.size, bool)
    for beside in (-1, 0, 1):
        turns[np.clip(group.loops.stop + beside, 0, mark.size - 1)] = True
    found = runs(mark)
    there = [(a, b) for a, b in found if turns[a:b].any()]
    expected = len(found) * float(turns.mean())
    out = np.zeros_like(mark)
    if len(there) > 1 and poisson_above(len(there) - 1, max(expected, 1e-9)) < OF_TURNS:
        for a, b in there:
            out[a:b] = True
    return out


def _filled(row: FloatArray, predicted: FloatArray, mark: NDArray[np.bool_]) -> FloatArray:
    """The marked samples put where their neighbours' residuals say."""
    good = np.flatnonzero(~mark)
    bad = np.flatnonzero(mark)
    out = row.copy()
    out[bad] = predicted[bad] + np.interp(bad, good, (row - predicted)[good])
    return out


def noise_floor_nm(groups: Groups) -> float | None:
    """Rms over samples of the between-repeat standard deviation; None without repeats."""
    square = count = 0.0
    for group in groups.groups:
        if group.repeats < 2:
            continue
        for a, b in group.blocks:
            rows = group.measured_um[:, a:b]
            rows = rows - rows.mean(axis=1, keepdims=True)
            square += float(np.sum(rows.var(axis=0, ddof=1)))
            count += b - a
    return 1e3 * float(np.sqrt(square / count)) if count else None
