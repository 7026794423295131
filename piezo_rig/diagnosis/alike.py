"""Recordings of one drive that were played after different ones, made alike.

Where an actuator remembers what was played before, such recordings are no repeats: what they
differ by would pass for noise, and hide what makes them differ.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes import CAUSES
from piezo_rig.causes.remanence import Remanence
from piezo_rig.chain import Model
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.scan import one_curve

FloatArray = NDArray[np.float64]
FEW = np.array([0.03, 0.2])
TRIED = np.array([0.01, 0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.65, 0.8])
AT_ALL = 0.99  # of that square, by one of the few, for all to be tried
LESS = 0.8  # of the mean square by which they differ, that memory must leave


def of_one_history(groups: Groups, model: Model) -> Groups:
    """As if all recordings of a drive had been played after the same ones."""
    return groups.with_([g.of_one_history(model) for g in groups.groups])


def differ(groups: Groups, model: Model) -> bool:
    """Whether recordings of one drive differ by what a model says is left of those before."""
    return any(g.remembers(model) for g in groups.groups)


def plainly_remembering(groups: Groups, model: Model) -> Model | None:
    """The model with as much memory as explains best what recordings of one drive differ by.

    None where that is not plain to see, or cannot be seen.
    """
    if Remanence.id not in CAUSES or not all(g.earlier for g in groups.groups):
        return None
    if not one_curve(model) or not differ(groups, _left(model, FEW[0])):
        return None
    before = _differing(groups)

    def worth(fractions: FloatArray) -> tuple[float, Model]:
        left = [_differing(of_one_history(groups, _left(model, f))) for f in fractions]
        best = int(np.argmin(left))
        return left[best], _left(model, fractions[best])

    if worth(FEW)[0] > AT_ALL * before:
        return None
    left, best = worth(TRIED)
    return best if left < LESS * before else None


def _left(model: Model, fraction: float) -> Model:
    return model.with_stage(Remanence.of(None, fraction=float(fraction)))


def _differing(groups: Groups) -> float:
    """Square, um^2, by which recordings differ from the mean of those of their drive."""
    out = 0.0
    for g in groups.groups:
        rows = g.measured_um - g.measured_um.mean(axis=0)
        for a, b in g.blocks:
            cut = rows[:, a:b] - rows[:, a:b].mean(axis=1, keepdims=True)
            out += float(np.sum(cut**2))
    return out
