"""Where on the interferometer's scale recordings of unknown history begin.

A periodic error follows the scale, and so must a model of it. What an actuator brought along from
before is not in its model, and some 150 nm of it turn the error round: every such drive has a phase
of its own. It is read off the ripple itself, where there is one: against displacement as it was
recorded, beside its neighbouring wavelengths.
"""

from __future__ import annotations

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
SEEN = 1e-5  # chance of such a ripple


@dataclass(frozen=True)
class _Ripple:
    """Of one drive: complex amplitude, its power beside the neighbours', and where a model's first
    sample is on the recorded scale, um.
    """

    amplitude: complex
    ratio: float
    begins_um: float


def on_one_scale(groups: Groups, model: Model) -> Groups:
    """The groups with what the scale reads where they begin; as they are where no ripple says so.

    ``model`` : fitted to them
    """
    if all(g.virgin for g in groups.groups):
        return groups
    found = [_ripple(g, model) for g in groups.groups]
    seen = [r for r in found if r is not None]
    if not seen:
        return groups
    score = sum(INDEPENDENT * np.log1p(r.ratio / INDEPENDENT) for r in seen)
    if chi2_above(2.0 * float(score), 2.0 * len(seen)) > SEEN:
        return groups
    known = [r.amplitude for g, r in zip(groups.groups, found, strict=True)
             if r is not None and g.virgin]  # fmt: skip
    begun = np.angle(sum(known)) if known else 0.0
    out = []
    for g, r in zip(groups.groups, found, strict=True):
        reads = 0.0
        if r is not None and not g.virgin:
            turned = float(np.angle(r.amplitude) - begun) / (2.0 * np.pi)
            reads = r.begins_um + turned * HALF_WAVE_UM
        out.append(replace(g, reads_um=reads))
    return groups.with_(out)


def _ripple(group: Group, model: Model) -> _Ripple | None:
    """The ripple over the longest stretch of a drive; None where too few periods are passed."""
    a, b = max(group.blocks, key=lambda block: block[1] - block[0])
    seen = group.measured_um[:, a:b].mean(axis=0) - float(group.measured_um[:, 0].mean())
    off = seen - group.predicted(model)[a:b]
    begins = 0.0 if group.virgin else float(off.mean())
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
    turns = np.exp(-2j * np.pi * np.outer(waves, seen - (0.0 if not group.virgin else begins)))
    lines = 2.0 * turns @ (left * weight) / weight.sum()
    level = float(np.mean(np.abs(lines[1:]) ** 2))
    return _Ripple(complex(lines[0]), float(np.abs(lines[0]) ** 2) / max(level, 1e-30), begins)


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
