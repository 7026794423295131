"""Recordings of one drive that were played after different ones, made alike.

Where an actuator remembers what was played before, or ages with every cycle of the session, such
recordings are no repeats: what they differ by would pass for noise, and hide what makes them
differ.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import helmert

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cycle_aging import CycleAging
from piezo_rig.causes.remanence import Remanence
from piezo_rig.causes.sensor_clipping import SensorClipping
from piezo_rig.chain import Model, Parameter
from piezo_rig.diagnosis.chances import chi2_above, student_above, student_half_width
from piezo_rig.diagnosis.flats import standing
from piezo_rig.diagnosis.groups import Group, Groups
from piezo_rig.diagnosis.left_before import left_before
from piezo_rig.diagnosis.unsteady import Unsteady, unsteady
from piezo_rig.diagnosis.whitening import CellWhitener

FloatArray = NDArray[np.float64]
FEW = np.array([0.03, 0.2])
TRIED = np.array([0.01, 0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.65, 0.8])
AT_ALL = 0.99  # of that square, by one of the few, for all to be tried
LESS = 0.8  # of the mean square by which they differ, that memory must leave
NOTHING = 1e-6  # of the largest square
AGED = 0.001  # a decade: so little that what it does is linear in it
# chances: that a gain is steady, for it to be asked whether it ages, and once that is taken off;
# a false alarm of this kind, among as many causes as are looked for
UNSTEADY, STEADY, FALSE, TRIED_BESIDE = 0.05, 0.01, 1e-3, 30


def of_one_history(groups: Groups, model: Model) -> Groups:
    """As if all recordings of a drive had been played after the same ones.

    Where a sensor ends they are alike as they are, and a model that knows of no end says nothing.
    """
    out = [g.of_one_history(model) for g in groups.groups]
    if model.stage(SensorClipping.id) is not None:
        return groups.with_(out)
    for k, (g, there) in enumerate(zip(groups.groups, out, strict=True)):
        if there is not g and (ends := standing(g)).any():
            out[k] = there.with_measured(np.where(ends, g.measured_um, there.measured_um))
    return groups.with_(out)


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


def _aged(model: Model, rate: Parameter) -> Model:
    """With a whole strain that grows through the session."""
    one = Parameter(1.0, "1")
    return model.with_stage(CycleAging({"rate_per_decade": rate, "whole": one, "session": one}))


def _ageing(groups: Groups, model: Model) -> tuple[float, Model] | None:
    """What ageing through the session leaves of the differences, its whole strain growing."""
    found = _rates(groups, model)
    if found is None:
        return None
    rates, weights = found
    aged = _aged(model, Parameter(float(rates @ weights), "1"))
    return _differing(of_one_history(groups, aged)), aged


def _rates(groups: Groups, model: Model) -> tuple[FloatArray, FloatArray] | None:
    """Rates of ageing through the session by which recordings of one drive differ, and what each
    counts, shapes (k,): as many of every drive as its recordings can differ in ways (one less than
    they are), whose noise is independent; those in which ageing makes no difference are left out.
    """
    little = _aged(model, Parameter(AGED, "1"))
    if not differ(groups, little):
        return None
    changes = of_one_history(groups, little)
    squares, products = list[FloatArray](), list[FloatArray]()
    for g, c in zip(groups.groups, changes.groups, strict=True):
        seen = ~standing(g)
        own, made = (np.concatenate(_apart(x, seen), axis=1)
                     for x in (g, g.with_measured(g.measured_um - c.measured_um)))  # fmt: skip
        ways = helmert(g.repeats)
        squares.append(np.sum((ways @ made) ** 2, axis=1))
        products.append(np.sum((ways @ made) * (ways @ own), axis=1))
    square, product = np.concatenate(squares), np.concatenate(products)
    kept = square > NOTHING * square.max(initial=0.0)
    if not kept.any():
        return None
    return AGED * product[kept] / square[kept], square[kept] / square[kept].sum()


def ages_unseen(
    groups: Groups, whitener: CellWhitener, model: Model,
    gain: Callable[[Groups], Unsteady | None],
) -> tuple[Model, float] | None:  # fmt: skip
    """The model with the ageing by which recordings of one drive differ, and its chance.

    Noise may hide it in every recording by itself. All together show it by how far the gain is from
    steady, and by how little the rates scatter among drives and repeats (Student's law); of noise,
    size and direction are independent, so both chances count (R. A. Fisher's sum of logarithms). It
    is believed where nothing unsteady is left. The interval of the rate is that of the scatter.

    ``gain`` : how unsteady it is beside the model
    """
    if model.counts_on or model.remembering:
        return None
    before = gain(groups)
    found = _rates(groups, model) if before and before.p_value < UNSTEADY else None
    if before is None or found is None or found[0].size < 3:
        return None
    rates, weights = found
    rate, freedom = float(rates @ weights), rates.size - 1
    spread = max(float(np.sqrt(weights @ (rates - rate) ** 2 / freedom)), 1e-300)
    both = before.p_value, 2.0 * student_above(abs(rate) / spread, freedom)
    logs = float(np.sum(np.log(np.maximum(both, 1e-300))))
    chance = TRIED_BESIDE * float(chi2_above(-2.0 * logs, 4))
    half = student_half_width(freedom) * spread
    aged = _aged(model, Parameter(rate, "1", (rate - half, rate + half)))
    if chance > FALSE:
        return None
    after = unsteady(of_one_history(groups, aged), whitener, aged)
    if after is None or after.p_value < STEADY:
        return None
    return aged, chance


def _remembering(groups: Groups, model: Model, before: float) -> tuple[float, Model] | None:
    """What the likeliest memory leaves of the differences; None where it cannot be seen."""
    if Remanence.id not in CAUSES or not all(g.earlier for g in groups.groups):
        return None
    if not model.one_curve or not differ(groups, _left(model, FEW[0])):
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
    return sum(float(np.sum(cut**2)) for g in groups.groups for cut in _apart(g, ~standing(g)))


def _apart(group: Group, seen: NDArray[np.bool_]) -> list[FloatArray]:
    """Of every block, each recording less their mean and its own, of samples that are seen, (R, k).
    """
    rows = group.measured_um - group.measured_um.mean(axis=0)
    cuts = [rows[:, a:b][:, seen[a:b]] for a, b in group.blocks if seen[a:b].any()]
    return [cut - cut.mean(axis=1, keepdims=True) for cut in cuts]
