"""Levels of a sensor as the recordings count them.

A model counts from where its own sweep begins. Of a recording of unknown history that is not the
recording's zero: what the actuator brought along lies between the two.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from piezo_rig.chain import Model, Parameter
from piezo_rig.diagnosis.groups import Groups


def as_recorded(groups: Groups, model: Model, p: Parameter) -> Parameter:
    """A level above the sweep's zero, of the recordings that reach it; as it is of virgin ones."""
    off: list[float] = []
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
            return p
        off += [float(np.mean(row[reached] - seen[reached])) for row in g.measured_um]
    if not off:
        return p
    shift, spread = float(np.mean(off)), 0.0
    if len(off) > 1:
        spread = 1.96 * float(np.std(off, ddof=1)) / np.sqrt(len(off))
    half = 0.5 * (p.ci95[1] - p.ci95[0]) if p.ci95 else 0.0
    wide = float(np.hypot(half, spread))
    value = p.value + shift
    return replace(p, value=value, ci95=(value - wide, value + wide) if p.ci95 else None)
