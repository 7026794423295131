"""Levels of a sensor as the recordings count them.

A model counts from where its own sweep begins. Of a recording of unknown history that is not the
recording's zero: what the actuator brought along lies between the two. The zero itself is one
sample, as uncertain as any.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from piezo_rig.chain import Model, Parameter
from piezo_rig.diagnosis.groups import Groups


def as_recorded(groups: Groups, model: Model, p: Parameter, noise_um: float) -> Parameter:
    """A level above the sweep's zero, of the recordings that reach it.

    ``noise_um`` : of one sample
    """
    off, virgins = list[float](), 0
    for g in groups.groups:
        seen = g.predicted(model)
        reached = np.abs(seen - p.value) < 1e-6 * groups.travel_um
        inside = np.zeros_like(reached)
        for a, b in g.blocks:
            inside[a:b] = True
        reached &= inside
        if not reached.any():
            continue
        if g.virgin:
            virgins += g.repeats
            continue
        off += [float(np.mean(row[reached] - seen[reached])) for row in g.measured_um]
    if virgins or not off:
        return _wider(p, 0.0, 1.96 * noise_um / np.sqrt(max(virgins, 1)))
    shift, spread = float(np.mean(off)), 0.0
    if len(off) > 1:
        spread = 1.96 * float(np.std(off, ddof=1)) / np.sqrt(len(off))
    return _wider(p, shift, spread)


def _wider(p: Parameter, shift: float, by: float) -> Parameter:
    """With another value, and an interval that is wider by an error of its own."""
    half = 0.5 * (p.ci95[1] - p.ci95[0]) if p.ci95 else 0.0
    wide, value = float(np.hypot(half, by)), p.value + shift
    return replace(p, value=value, ci95=(value - wide, value + wide) if p.ci95 else None)
