"""Recordings of one drive that were played after different ones, made alike.

Where an actuator remembers what was played before, or ages with every cycle of the session, such
recordings are no repeats: what they differ by would pass for noise, and hide what makes them
differ.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cycle_aging import CycleAging
from piezo_rig.causes.remanence import Remanence
from piezo_rig.chain import Model
from piezo_rig.diagnosis.groups import Group, Groups
from piezo_rig.diagnosis.left_before import left_before
from piezo_rig.diagnosis.scan import one_curve

FloatArray = NDArray[np.float64]
FEW = np.array([0.03, 0.2])
TRIED = np.array([0.01, 0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.65, 0.8])
AT_ALL = 0.99  # of that square, by one of the few, for all to be tried
LESS = 0.8  # of the mean square by which they differ, that memory must leave
AGED = 0.001  # a decade: so little that what it does is linear in it


def of_one_history(groups: Groups, model: Model) -> Groups:
    """As if all recordings of a drive had been played after the same ones."""
    return groups.with_([g.of_one_history(model) for g in groups.groups])


def differ(groups: Groups, model: Model) -> bool:
    """Whether recordings of one drive differ by what a model says is left of those before."""
    return any(g.remembers(model) for g in groups.groups)


def numbers_apart(model: Model) -> tuple[float, ...]:
    """Numbers of a model on which it depends what recordings of one drive differ by."""
    counting = [s for s in model.stages if s.counts_on]
    return (*left_before(model), *(p.value for s in counting for p in s.parameters.values()))


def plainly_apart(groups: Groups, model: Model) -> Model | None:
    """The model with as much memory, or ageing, as explains what recordings of one drive differ by.

    None where neither is plain to see.
    """
    before = _differing(groups)
    told = [found for found in (_remembering(groups, model, before), _ageing(groups, model))
            if found is not None and found[0] < LESS * before]  # fmt: skip
    return min(told, key=lambda found: found[0])[1] if told else None


def _ageing(groups: Groups, model: Model) -> tuple[float, Model] | None:
    """What ageing through the session leaves of the differences, its whole strain growing."""
    def aged(rate: float) -> Model:
        return model.with_stage(
            CycleAging.of(None, rate_per_decade=rate, whole=1.0, session=1.0)
        )

    if not differ(groups, aged(AGED)):
        return None
    changes = of_one_history(groups, aged(AGED))
    square = product = 0.0
    for g, c in zip(groups.groups, changes.groups, strict=True):
        own, made = _apart(g), _apart(g.with_measured(g.measured_um - c.measured_um))
        square += sum(float(np.sum(m**2)) for m in made)
        product += sum(float(np.sum(a * m)) for a, m in zip(own, made, strict=True))
    if not square > 0.0:
        return None
    found = aged(AGED * product / square)
    return _differing(of_one_history(groups, found)), found


def _remembering(groups: Groups, model: Model, before: float) -> tuple[float, Model] | None:
    """What the likeliest memory leaves of the differences; None where it cannot be seen."""
    if Remanence.id not in CAUSES or not all(g.earlier for g in groups.groups):
        return None
    if not one_curve(model) or not differ(groups, _left(model, FEW[0])):
        return None

    def worth(fractions: FloatArray) -> tuple[float, Model]:
        left = [_differing(of_one_history(groups, _left(model, f))) for f in fractions]
        best = int(np.argmin(left))
        return left[best], _left(model, fractions[best])

    if worth(FEW)[0] > AT_ALL * before:
        return None
    return worth(TRIED)


def _left(model: Model, fraction: float) -> Model:
    return model.with_stage(Remanence.of(None, fraction=float(fraction)))


def _differing(groups: Groups) -> float:
    """Square, um^2, by which recordings differ from the mean of those of their drive."""
    return sum(float(np.sum(cut**2)) for g in groups.groups for cut in _apart(g))


def _apart(group: Group) -> list[FloatArray]:
    """Of every block, each recording less their mean and its own, (R, n)."""
    rows = group.measured_um - group.measured_um.mean(axis=0)
    return [rows[:, a:b] - rows[:, a:b].mean(axis=1, keepdims=True) for a, b in group.blocks]
