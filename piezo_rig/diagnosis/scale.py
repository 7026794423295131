"""Where on the interferometer's scale recordings begin.

A periodic error follows the scale, and so must a model of it. What an actuator brought along from
before is not in its model, nor what drifted between two recordings, and some 150 nm of either turn
the error round: every recording has a phase of its own. It is read off the ripple itself, where
there is one: against displacement, beside its neighbouring wavelengths. Recordings of one drive at
different phases are turned to that of the first: their mean would hold no ripple.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes.periodic_nonlinearity import HALF_WAVE_UM
from piezo_rig.chain import Model
from piezo_rig.diagnosis.chances import chi2_above
from piezo_rig.diagnosis.groups import Group, Groups

FloatArray = NDArray[np.float64]
DEGREE = 8  # of what is smooth over the drive, on each way
NEXT, LAST = 2.0, 9.0  # resolution cells of the neighbouring wavelengths
INDEPENDENT = 10.0  # of those cells
WAVES = 4.0  # periods that a recording must pass
SEEN = 1e-5  # chance of such a ripple, or of phases that differ so much
TURN_UM = 2.0 * np.pi / HALF_WAVE_UM  # radians in a micrometre
TURNS = 3
SAME_V = 0.02  # between drives that come again


@dataclass(frozen=True)
class _Ripple:
    """Of one recording: complex amplitude, um, over its displacement from where it is in the mean
    over time; that mean from its first sample, um; the power of neighbouring wavelengths, um2.
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
    """The groups with what the scale reads where they are recorded; as they are where no ripple
    says so.

    Virgin recordings begin at the same reading, unless their phases plainly differ.

    ``model`` : fitted to them
    """
    found = [_ripple(g, model, g.measured_um.mean(axis=0)) for g in groups.groups]
    virgins = [
        replace(r, amplitude=r.from_first)
        for g, r in zip(groups.groups, found, strict=True) if r is not None and g.virgin
    ]  # fmt: skip
    alike = not _differ([virgins])
    if alike and all(g.virgin for g in groups.groups):
        return groups
    seen = [r for r in found if r is not None]
    if not seen or not _unlikely([r.ratio for r in seen]):
        return groups
    begun = float(np.angle(sum(r.amplitude for r in virgins))) if virgins else 0.0
    out = []
    for g, r in zip(groups.groups, found, strict=True):
        if g.virgin and (alike or r is None):
            reads = begun / TURN_UM + _middle_um(g.measured_um.mean(axis=0))
        else:
            reads = float(np.angle(r.amplitude)) / TURN_UM if r is not None else 0.0
        out.append(replace(g, reads_um=reads))
    return groups.with_(out)


def at_one_phase(groups: Groups, model: Model) -> Groups:
    """The groups with all recordings of a drive at the first one's phase of the error; as they are
    where the phases do not differ.

    ``model`` : fitted to them
    """
    each = [[_ripple(g, model, row) for row in g.measured_um] for g in groups.groups]
    seen = [[r for r in rows if r is not None] for rows in each]
    if not _differ(seen):
        return groups
    rate = _drifts(groups)
    return groups.with_([
        _turned(g, [r for r in rows if r is not None], rate) if all(rows) else g
        for g, rows in zip(groups.groups, each, strict=True)
    ])  # fmt: skip


def _turned(group: Group, ripples: Sequence[_Ripple], rate: float) -> Group:
    """Every recording with its own ripple taken off and the first one's put in, one size for all.

    The ripple taken off is over what the recording reads, which moves with what drifts meanwhile,
    at so many um/s; the one put in is not.
    """
    rows, size = group.measured_um, float(np.mean([abs(r.amplitude) for r in ripples]))
    drifted = rate * (group.time_s - float(np.mean(group.time_s)))

    def error(at_um: FloatArray, ripple: _Ripple) -> FloatArray:
        return np.asarray(size * np.cos(TURN_UM * at_um + np.angle(ripple.amplitude)))

    out = []
    for row, own in zip(rows, ripples, strict=True):
        seen = row - row.mean()
        reads = seen
        for _ in range(TURNS):  # what is read has the error in it
            reads = seen - error(reads, own)
        out.append(row - error(reads, own) + error(reads - drifted, ripples[0]))
    return group.with_measured(np.array(out))


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


def _ripple(group: Group, model: Model, measured_um: FloatArray) -> _Ripple | None:
    """The ripple of a recording (n,) over the longest stretch of a drive; None where too few
    periods are passed.
    """
    a, b = _longest(group)
    middle = _middle_um(measured_um)
    seen = measured_um[a:b] - float(measured_um[0]) - middle
    off = seen - group.predicted(model)[a:b]
    low, travel = float(seen.min()), float(np.ptp(seen))
    if travel < WAVES * HALF_WAVE_UM:
        return None
    left = _rough(off, group.drive_v[a:b])
    step = np.abs(np.gradient(seen))
    weight = step * np.sin(np.pi * (seen - low) / travel) ** 2
    cells = np.arange(NEXT, LAST, 0.5)
    beside = np.concatenate([-cells, cells]) / travel
    waves = 1.0 / HALF_WAVE_UM + np.concatenate([[0.0], beside])
    waves = waves[waves > NEXT / travel]
    lines = 2.0 * np.exp(-2j * np.pi * np.outer(waves, seen)) @ (left * weight) / weight.sum()
    level = max(float(np.mean(np.abs(lines[1:]) ** 2)), 1e-30)
    return _Ripple(complex(lines[0]), middle, level)


def _middle_um(measured_um: FloatArray) -> float:
    """Mean over time of a recording (n,), from its first sample."""
    return float(measured_um.mean() - measured_um[0])


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
