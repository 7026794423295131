"""The constant part of a first spring that follows a law, and how well the data know it.

k_1 = slope x history + offset (thesis eq. 7-10). While a law is looked for its offset is part of
the element table, but for what only a first rise by the same elements shows: by how much the later
branch is steeper up to the law's reach than on the same stretch after it. Here it is taken out of
the table, for the report and for the model file.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes.first_spring import FirstSpring
from piezo_rig.chain import Elements, Model, Parameter
from piezo_rig.chain.branches import Reaching
from piezo_rig.chain.half_loops import half_loops
from piezo_rig.diagnosis.compliances import smooth_weight
from piezo_rig.diagnosis.fit import smoothness
from piezo_rig.diagnosis.refit import Fitted
from piezo_rig.diagnosis.space import Space

FloatArray = NDArray[np.float64]
HALFWAY = 0.5
OPEN = 0.3  # of a spring that keeps its force, which the table may hold as well
STEP = 1e-3  # relative, of finite differences


def spring_of(table: Elements, reach_um: float) -> float:
    """Constant part of the first spring, V/um.

    By how much the branch is steeper up to the reach than it goes on after it. Other elements give
    way on that stretch as well, so right behind the reach it is steeper than on the average: how
    much is between nothing and what a straight line through the next two stretches says.
    """
    first, second, third = (_slope(table, k * reach_um, (k + 1) * reach_um) for k in range(3))
    return first - second - HALFWAY * 0.5 * (second - third)


def _slope(table: Elements, begin_um: float, end_um: float) -> float:
    """Mean slope of a later branch between two displacements, V/um; the last one goes on."""
    ends, volts = np.append(0.0, table.slides_at_um), np.append(0.0, table.knots_v)

    def at(x: float) -> float:
        past = max(x - float(ends[-1]), 0.0)
        return float(np.interp(x, ends, volts) + past * table.slopes[-1])

    return 2.0 * (at(0.5 * end_um) - at(0.5 * begin_um)) / (end_um - begin_um)


def _depends(table: Elements, reach_um: float) -> float:
    """By how much it matters where the branch "after the first spring" is taken to be, V/um."""
    usual = _slope(table, reach_um, 2.0 * reach_um)
    return max(abs(_slope(table, reach_um, k * reach_um) - usual) for k in (1.5, 3.0))


def reach_of(stage: FirstSpring, table: Elements) -> float:
    """Displacement after a turning point up to which the law holds, um."""
    if "reach" in stage.parameters:
        return stage["reach"]
    return 2.0 * float(table.slides_at_um[0])


def with_offset(fitted: Fitted, model: Model, stage: FirstSpring) -> Model:
    """The same model, the first spring's constant part moved from the table to its law.

    Without elements of its own for the first rise the table stays: the first rise follows it as
    well. The offset is then only reported; see `offset_of`.
    """
    table = model.maxwell.elements
    assert table is not None
    if model.one_curve or stage.holds_force:
        return model
    law = type(stage)(stage.parameters | {"offset": offset_of(fitted, stage)})
    moved = type(model.maxwell).of(without_offset(table, stage, law["offset"] - stage["offset"]))
    return model.with_(stages=tuple(
        moved if s.id == "maxwell" else law if s.id == stage.id else s for s in model.stages
    ))  # fmt: skip


def without_offset(table: Elements, stage: FirstSpring, offset: float) -> Elements:
    """The table less what an offset of that law, V/um, adds to every later branch.

    A law that fades out does so in steps, and one that closes takes back: a spring for each end.
    """
    numbers = {name: p.value for name, p in stage.parameters.items()}
    own = Reaching(
        reach_of(stage, table), lambda slopes, loops: slopes + offset,
        numbers.get("closing", 0.0), numbers.get("taper", 0.0) > 0,
    )  # fmt: skip
    ends, added = own.added(offset)
    for end, spring in zip(ends, -np.diff(added, append=0.0), strict=True):
        table = table.with_spring(-float(spring), 0.5 * float(end))
    return table


def offset_of(fitted: Fitted, stage: FirstSpring) -> Parameter:
    """The offset with its interval, from a fit whose table still holds it.

    Compliances are uncertain by the noise, and follow the slope and the reach.
    """
    table = fitted.point.model.maxwell.elements
    assert table is not None
    if stage.holds_force:
        return _own(fitted, stage)
    reach, unit = reach_of(stage, table), stage.units["offset"]
    value = stage["offset"] + spring_of(table, reach)
    n, q = fitted.point.linear, len(fitted.point.sizes)
    if fitted.point.fixed or fitted.covariance.shape != (q, q):
        return Parameter(value, unit)
    compliance = 1.0 / table.slopes
    gradient = np.zeros(n)
    for k in range(compliance.size):
        there = compliance.copy()
        there[k] *= 1.0 + STEP
        other = spring_of(Elements.from_curve(table.knots_v, there), reach)
        gradient[k] = (other - spring_of(table, reach)) / (STEP * compliance[k])
    raw = fitted.linear.raw()
    rows = smoothness(fitted.point)[:, :n]
    gram = raw[:n, :n] + smooth_weight(fitted.point, fitted.linear) * rows.T @ rows
    gram += 1e-12 * np.diag(np.diag(gram)) + 1e-300 * np.eye(n)
    solved = np.linalg.solve(gram, gradient)
    noise = raw[-1, -1] / max(float(fitted.linear.count.sum()), 1.0)
    follows = -solved @ raw[:n, n : n + q]  # by the stage parameters
    for j, (id, name) in enumerate(fitted.point.names):
        if id == stage.id and name == "reach":
            wider = spring_of(table, reach * (1.0 + STEP))
            follows[j] += (wider - spring_of(table, reach)) / (STEP * reach)
        if id == stage.id and name == "offset":
            follows[j] += 1.0
    variance = noise * float(gradient @ solved) + float(follows @ fitted.covariance @ follows)
    half = float(np.hypot(1.96 * np.sqrt(max(variance, 0.0)), _depends(table, reach)))
    return Parameter(value, unit, (value - half, value + half))


def _own(fitted: Fitted, stage: FirstSpring) -> Parameter:
    """The offset of a spring that the table does not hold.

    Which spring's place it takes is chosen, not measured, and the offset goes with it: it is as
    open as that spring is off the mean of those that the law makes, and the table may hold a part.
    """
    value, unit = stage["offset"], stage.units["offset"]
    if (stage.id, "offset") not in fitted.point.names or not fitted.covariance.size:
        return Parameter(value, unit)
    at = fitted.point.names.index((stage.id, "offset"))
    mean = stage["slope"] * float(history_v(fitted.space, stage).mean()) + value
    spread = 1.96 * float(np.sqrt(max(fitted.covariance[at, at], 0.0)))
    half = float(np.sqrt(spread**2 + (mean - stage["spring"]) ** 2 + (OPEN * mean) ** 2))
    return Parameter(value, unit, (value - half, value + half))


def history_v(space: Space, stage: FirstSpring) -> FloatArray:
    """What a law follows, of all half loops but the first of every drive, V."""
    loops = [half_loops(g.drive_v) for g in space.groups.groups]
    return np.concatenate([stage.history(own)[1:] for own in loops])
