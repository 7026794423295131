"""Where recordings stand on the scale of the interferometer.

A recording of unknown history begins elsewhere than a model of it, and counts from there: where
it stands is told by its mean over the time that its memory is known (`chain.placed`).

A periodic error follows the interferometer's scale, and so must a model of it. What an actuator
brought along from before is not in its model, nor what drifted between two recordings, and some
150 nm of either turn the error round: every recording has a phase of its own. It is read off the
ripple itself, where there is one: against displacement, beside its neighbouring wavelengths.
Recordings of one drive at different phases are turned to that of the first: their mean would hold
no ripple.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes.periodic_nonlinearity import HALF_WAVE_UM
from piezo_rig.chain import Model, Reads
from piezo_rig.diagnosis.chances import chi2_above
from piezo_rig.diagnosis.groups import Group, Groups

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
DEGREE = 8  # of what is smooth over the drive, on each way
NEXT, LAST = 2.0, 9.0  # resolution cells of the neighbouring wavelengths
INDEPENDENT = 10.0  # of those cells
WAVES = 4.0  # periods that a recording must pass
SEEN = 1e-5  # chance of such a ripple, or of phases that differ so much
TURN_UM = 2.0 * np.pi / HALF_WAVE_UM  # radians in a micrometre
TURNS = 3
ANEW = 0.05  # radians, by which phases must have moved
INSIDE_S = 1e-8
STILL, STILL_V = 200, 1e-3  # samples; volts
SAME_V = 0.02  # between drives that come again


@dataclass(frozen=True)
class _Ripple:
    """Of one block of one recording: complex amplitude, um, over its displacement from the mean
    there; that mean from its first sample, um; the power of neighbouring wavelengths, um2.
    """

    amplitude: complex
    middle_um: float
    level: float

    @property
    def ratio(self) -> float:
        """Power, of that of its neighbours."""
        return abs(self.amplitude) ** 2 / self.level

    @property
    def from_first(self) -> complex:
        """The amplitude over the displacement from the first sample."""
        return self.amplitude * complex(np.exp(-1j * TURN_UM * self.middle_um))


def on_one_scale(groups: Groups, model: Model) -> Groups:
    """The groups with what is known of where their recordings stand; as they are where all begin
    virgin, and no ripple tells them apart.

    ``model`` : fitted to them; not asked where that is known already
    """
    if any(g.reads is not None for g in groups.groups):
        return groups
    means = [g.measured_um.mean(axis=0) for g in groups.groups]
    found = [
        [_ripple(g, model, mean, k) for k in range(len(g.blocks))]
        for g, mean in zip(groups.groups, means, strict=True)
    ]
    virgins = [
        replace(r, amplitude=r.from_first)
        for g, own in zip(groups.groups, found, strict=True) if g.virgin
        for r in own if r is not None
    ]  # fmt: skip
    alike = not _differ([virgins])
    if alike and all(g.virgin for g in groups.groups):
        return groups
    seen = [r.ratio for own in found for r in own if r is not None]
    if not seen or not _unlikely(seen):
        return groups
    begun = float(np.angle(sum(r.amplitude for r in virgins))) if virgins else 0.0
    out = []
    for g, own, mean in zip(groups.groups, found, means, strict=True):
        reads = []
        for (a, b), r in zip(g.blocks, own, strict=True):
            middle = _middle_um(g, mean, a, b)
            if g.virgin and (alike or r is None):
                scale = begun / TURN_UM + middle
            else:
                scale = float(np.angle(r.amplitude)) / TURN_UM if r is not None else 0.0
            to_s = float(g.time_s[b - 1]) + INSIDE_S
            reads.append(Reads(float(g.time_s[a]), to_s, scale))
        out.append(replace(g, reads=tuple(reads)))
    return groups.with_(out)


def read_anew(
    whole: Groups, known: Groups, model: Model
) -> Groups | None:
    """The groups on one scale, and at one phase, as a better model tells; None where that is as it
    was known.

    Parameters
    ----------
    whole : as they were recorded
    known : with their places, as a poorer model told them
    model : that leaves the ripple, and as little else as can be
    """
    out = on_one_scale(at_one_phase(whole, model), model)
    off = []
    for before, after in zip(known.groups, out.groups, strict=True):
        for r, s in zip(before.reads or (), after.reads or (), strict=False):
            off.append(s.scale_um - r.scale_um)
    turned = np.exp(1j * TURN_UM * np.array(off))
    apart = np.angle(turned * np.conj(turned.mean())) if off else np.zeros(1)
    return out if float(np.abs(apart).max()) > ANEW else None


def at_one_phase(groups: Groups, model: Model) -> Groups:
    """The groups with all recordings of a drive at the first one's phase of the error; as they are
    where the phases do not differ.

    ``model`` : fitted to them
    """
    each = [
        [[_ripple(g, model, row, k) for row in g.measured_um] for k in range(len(g.blocks))]
        for g in groups.groups
    ]
    if not _differ([[r for r in rows if r is not None] for own in each for rows in own]):
        return groups
    rate, out = _drifts(groups), []
    for g, own in zip(groups.groups, each, strict=True):
        measured = g.measured_um.copy()
        for (a, b), rows in zip(g.blocks, own, strict=True):
            if all(rows):
                begin = 0 if a == g.blocks[0][0] else a
                cut = slice(begin, b)
                measured[:, cut] = _turned(
                    g.measured_um[:, cut], rate * g.time_s[cut], a - begin,
                    [r for r in rows if r is not None],
                )  # fmt: skip
        out.append(g.with_measured(measured))
    return groups.with_(out)


def _turned(
    rows: FloatArray, drifted: FloatArray, known: int, ripples: Sequence[_Ripple]
) -> FloatArray:
    """Every recording (r, n) with its own ripple taken off and the first one's put in, one size
    for all.

    The ripple taken off is over what the recording reads, which moves with what drifts meanwhile;
    the one put in is not.

    ``known`` : sample from which on the memory is known
    """
    size = float(np.mean([abs(r.amplitude) for r in ripples]))
    drifted = drifted - drifted[known:].mean()

    def error(at_um: FloatArray, ripple: _Ripple) -> FloatArray:
        return np.asarray(size * np.cos(TURN_UM * at_um + np.angle(ripple.amplitude)))

    out = []
    for row, own in zip(rows, ripples, strict=True):
        seen = row - row[known:].mean()
        reads = seen
        for _ in range(TURNS):  # what is read has the error in it
            reads = seen - error(reads, own)
        out.append(row - error(reads, own) + error(reads - drifted, ripples[0]))
    return np.array(out)


def _drifts(groups: Groups) -> float:
    """How fast recordings drift, um/s: from one cycle to the next, at the same drive; 0 where no
    cycle comes again.
    """
    moved, passed = 0.0, 0.0
    for g in groups.groups:
        first, last = _longest(g)
        for k in range(1, len(g.loops) - 2):  # the first rise is like no other
            a, b = int(g.loops.start[k]), int(g.loops.start[k + 2])
            n = min(b - a, last - b)
            if a < first or n < 2 or np.ptp(g.drive_v[b : b + n] - g.drive_v[a : a + n]) > SAME_V:
                continue
            went = g.measured_um[:, b : b + n] - g.measured_um[:, a : a + n]
            weight = went.size * float(g.time_s[b] - g.time_s[a])
            moved += float(went.mean()) * went.size
            passed += weight
    return moved / passed if passed else 0.0


def _differ(each: Sequence[Sequence[_Ripple]]) -> bool:
    """Whether ripples that should be alike, list by list, plainly are not."""
    ratios, each = list[float](), [same for same in each if len(same) > 1]
    for same in each:
        weights = np.array([1.0 / r.level for r in same])
        mean = sum(r.amplitude * w for r, w in zip(same, weights, strict=True)) / weights.sum()
        spare = len(same) / (len(same) - 1)  # the mean has been fitted to them
        ratios += [abs(r.amplitude - mean) ** 2 / r.level * spare for r in same]
    powers = [r.ratio for same in each for r in same]
    return bool(ratios) and _unlikely(powers) and _unlikely(ratios)


def _unlikely(ratios: Sequence[float]) -> bool:
    """Whether so much power, of that of the neighbours, is more than they show by chance."""
    score = sum(INDEPENDENT * np.log1p(r / INDEPENDENT) for r in ratios)
    return bool(chi2_above(2.0 * float(score), 2.0 * len(ratios)) < SEEN)


def _ripple(group: Group, model: Model, measured_um: FloatArray, k: int) -> _Ripple | None:
    """The ripple of the k-th block of a recording (n,); None where too few periods are passed."""
    a, b = group.blocks[k]
    middle = _middle_um(group, measured_um, a, b)
    seen = measured_um[a:b] - float(measured_um[a:b].mean())
    off = seen - group.predicted(model)[a:b]
    low, travel = float(seen.min()), float(np.ptp(seen))
    if travel < WAVES * HALF_WAVE_UM:
        return None
    left = _rough(off, group.drive_v[a:b])
    step = np.abs(np.gradient(seen))
    weight = step * np.sin(np.pi * (seen - low) / travel) ** 2
    line = np.exp(-1j * TURN_UM * seen) * (2.0 * left * weight / weight.sum())
    level = max(float(np.mean(np.abs(_beside(line, seen, travel)) ** 2)), 1e-30)
    return _Ripple(complex(line.sum()), middle, level)


def _beside(line: ComplexArray, seen: FloatArray, travel: float) -> ComplexArray:
    """Amplitudes at neighbouring wavelengths.

    ``line`` : shape (n,), which adds up to the amplitude at half a wave; from one neighbour to the
    next it is turned further by the same, which takes no exponentials
    """
    step = np.exp(-1j * np.pi * seen / travel)  # half a cell
    cells = np.arange(NEXT, LAST, 0.5)
    further = step ** round(2 * NEXT)
    longer, shorter = line * np.conj(further), line * further
    out = []
    for cell in cells:
        out.append(shorter.sum())
        if 1.0 / HALF_WAVE_UM - cell / travel > NEXT / travel:
            out.append(longer.sum())
        shorter *= step
        longer *= np.conj(step)
    return np.array(out)


def _middle_um(group: Group, measured_um: FloatArray, a: int, b: int) -> float:
    """Mean of a block of a recording (n,) from where that begins, while the drive stands still."""
    begin = 0 if a == group.blocks[0][0] else a
    drive = group.drive_v[begin : begin + STILL]
    moved = np.abs(drive - drive[0]) > STILL_V
    still = int(np.argmax(moved)) if moved.any() else drive.size
    return float(measured_um[a:b].mean() - measured_um[begin : begin + max(still, 1)].mean())


def _longest(group: Group) -> tuple[int, int]:
    """First, and one past the last, sample of the longest block."""
    return max(group.blocks, key=lambda block: block[1] - block[0])


def _rough(off: FloatArray, drive_v: FloatArray) -> FloatArray:
    """What is left (n,) once whatever is smooth over the drive is taken out, either way alone."""
    rising = np.gradient(drive_v) > 0
    x = 2.0 * (drive_v - drive_v.min()) / max(float(np.ptp(drive_v)), 1e-30) - 1.0
    out = np.empty_like(off)
    for way in (rising, ~rising):
        if way.sum() <= 2 * DEGREE:
            out[way] = 0.0
            continue
        shapes = np.polynomial.chebyshev.chebvander(x[way], DEGREE)
        out[way] = off[way] - shapes @ np.linalg.lstsq(shapes, off[way], rcond=None)[0]
    return out
