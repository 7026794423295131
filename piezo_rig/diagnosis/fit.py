"""A model as a point in parameter space: its free numbers, its tangent, its refit.

The free numbers are the compliances of the element tables at fixed break points, and the
parameters of all other stages. The tangent is taken by finite differences of the simulation, so
that whatever `simulate` can play can be refitted; nothing here knows a cause by name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes.cause import Cause
from piezo_rig.chain import Elements, Maxwell, Model, Stage
from piezo_rig.chain.bend import Bend
from piezo_rig.chain.reach import longest_branch
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.together import Together

FloatArray = NDArray[np.float64]
ELEMENTS = 80
CLOSER = 1.5
FLOOR = 1e-3  # of the mean compliance
SECOND = 0.05  # plausible second difference of compliances, of their mean
CURVED = 0.4  # plausible second derivative of a bend over its span, of the travel
STEP = 0.02  # finite differences of stage parameters, in examples


@dataclass(frozen=True, eq=False)
class Point:
    """A model and which of its numbers are free.

    Attributes
    ----------
    model : the stages
    fixed : ids of stages that are held, those of a given model file; offsets are always free
    sizes : (stage id, parameter) -> the size of one example, for finite differences
    """

    model: Model
    fixed: tuple[str, ...] = ()
    sizes: tuple[tuple[str, str, float], ...] = ()

    def __getstate__(self) -> dict[str, Any]:
        """What it is made from; its neighbours are made anew where they are needed."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @property
    def tables(self) -> list[Stage]:
        stages = [s for s in self.model.stages if s.id not in self.fixed]
        return [s for s in stages if s.elements is not None]

    @property
    def has_first_rise(self) -> bool:
        """Whether the model has a curve of its own for the first rise."""
        return not self.model.one_curve

    @property
    def compliances(self) -> int:
        """How many compliances are free."""
        return sum(len(s.elements) for s in self.tables if s.elements is not None)

    @property
    def at_their_least(self) -> bool:
        """Whether an element's compliance is as small as it can be."""
        for stage in self.tables:
            assert stage.elements is not None
            c = 1.0 / stage.elements.slopes
            if c.min() < 2.0 * FLOOR * c.mean():
                return True
        return False

    @property
    def coefficients(self) -> list[tuple[str, str]]:
        """Parameters that are fitted with the compliances: stage and name."""
        return [(s.id, n) for s in self.model.stages if s.id not in self.fixed for n in s.linear]

    @property
    def linear(self) -> int:
        """How many numbers are fitted by linear least squares."""
        return self.compliances + len(self.coefficients)

    @property
    def names(self) -> list[tuple[str, str]]:
        """Free stage parameters."""
        return [(stage, name) for stage, name, _ in self.sizes]

    def without(self, cause: str) -> Point:
        """The same point without a cause."""
        sizes = tuple(s for s in self.sizes if s[0] != cause)
        return Point(self.model.without(cause), self.fixed, sizes)

    def values(self) -> FloatArray:
        """All free numbers: compliances, linear coefficients, then stage parameters."""
        parts = [1.0 / s.elements.slopes for s in self.tables if s.elements is not None]
        own = [self._stage(i)[n] for i, n in [*self.coefficients, *self.names]]
        return np.concatenate([*parts, own])

    def _stage(self, id: str) -> Stage:
        stage = self.model.stage(id)
        assert stage is not None
        return stage

    def moved(self, values: FloatArray) -> Point:
        """The same point with other numbers; compliances stay positive, parameters in limits."""
        model, at = self.model, 0
        for stage in self.tables:
            assert stage.elements is not None
            n = len(stage.elements)
            c = values[at : at + n]
            at += n
            if np.array_equal(c, 1.0 / stage.elements.slopes):  # the same stage: see `Memo`
                continue
            c = np.maximum(c, FLOOR * float(np.mean(np.abs(c))))
            model = _replaced(
                model, type(stage)(stage.parameters, Elements.from_curve(stage.elements.knots_v, c))
            )
        names = [*self.coefficients, *self.names]
        for (id, name), value in zip(names, values[at:], strict=True):
            own = model.stage(id)
            assert own is not None
            if isinstance(own, Cause) and name in own.limits:
                value = float(np.clip(value, *own.limits[name]))
            if value != own[name]:
                model = _replaced(model, own.with_values(**{name: float(value)}))
        return Point(model, self.fixed, self.sizes)

    @property
    def others(self) -> range:
        """The free numbers that are no compliances."""
        return range(self.compliances, self.linear + len(self.sizes))

    def of_stage(self, id: str) -> list[int]:
        """Which free numbers are parameters of a stage."""
        return [self.linear + j for j, (stage, _) in enumerate(self.names) if stage == id]

    def neighbours(self, numbers: Sequence[int]) -> list[tuple[Model, float]]:
        """For each of these free numbers a model a little to its side, and how far."""
        key = tuple(numbers)
        if key not in self._known:
            self._known[key] = [self._neighbour(j) for j in key]
        return self._known[key]

    @cached_property
    def _known(self) -> dict[tuple[int, ...], list[tuple[Model, float]]]:
        return {}

    def _neighbour(self, j: int) -> tuple[Model, float]:
        values = self.values()
        if j < self.compliances:
            step = 1e-3 * float(np.mean(np.abs(values[: self.compliances])))
        elif j < self.linear:
            step = 1e-3
        else:
            step = STEP * self.sizes[j - self.linear][2]
        there = values.copy()
        there[j] += step
        point = self.moved(there)
        moved = point.values()[j]
        if moved == values[j]:  # at a limit
            there[j] = values[j] - step
            point, moved = self.moved(there), there[j]
        return point.model, float(moved - values[j])

    def tangent(self, data: Together, numbers: Sequence[int]) -> FloatArray:
        """Derivative of the prediction by free numbers, (k, n), of thinned data."""
        near = self.neighbours(numbers)
        changes = data.changes(data.remembered(self.model), [model for model, _ in near])
        return changes / np.array([step for _, step in near])[:, None]


def _replaced(model: Model, stage: Stage) -> Model:
    return model.with_(stages=tuple(stage if s.id == stage.id else s for s in model.stages))


def starting_model(groups: Groups, kinds: tuple[type[Stage], ...], name: str) -> Model:
    """A Maxwell model with evenly spaced elements and the stages given, roughly sized."""
    virgin = [float(np.max(np.abs(g.drive_v - g.drive_v[0]))) for g in groups.groups if g.virgin]
    later = max(longest_branch(g.drive_v, g.loops, g.blocks) for g in groups.groups)
    later = later or groups.span_v
    reach = max([later / 2.0, *virgin])
    c = groups.travel_um / reach
    count = ELEMENTS
    if any(k.has_elements for k in kinds):
        table = _graded(later / 2.0 * 1.0001, count, c)
        stages: list[Stage] = [Maxwell.of(table)]
        for kind in kinds:
            if kind.has_elements:
                rise = max(virgin) if virgin else reach
                stages.append(kind.of(_graded(rise * 1.0001, count, c)))
    else:
        stages = [Maxwell.of(_graded(reach * 1.0001, count, c))]
    model = Model(tuple(stages), {}, name)
    for kind in kinds:
        if not kind.has_elements:
            model = model.with_stage(
                kind.of(None, **{n: kind.neutral.get(n, 0.0) for n in kind.units})
            )
    return model


def _graded(reach: float, count: int, compliance: float) -> Elements:
    # closer together right after a turning point, where lags and laws show
    knots = reach * (np.arange(1, count + 1) / count) ** CLOSER
    return Elements.from_curve(knots, np.full(count, compliance))


def smoothness(point: Point) -> FloatArray:
    """What compliances are held to where data do not say, as rows over all free numbers.

    Second differences of the later branches' compliances. The first rise's are held to those of
    the later branches: first differences of what they differ by, so that a first rise beyond the
    data goes on as the other curve does. A memoryless bend has little curvature: much of it is
    what a table does as well, and drives of one amplitude hardly tell the two apart.
    """
    rows, at, size = [], 0, point.values().size
    later: tuple[int, FloatArray] | None = None
    for stage in point.tables:
        assert stage.elements is not None
        n = len(stage.elements)
        knots = stage.elements.knots_v
        if later is None:
            later = (at, knots)
            for k in range(1, n - 1):
                row = np.zeros(size)
                row[at + k - 1 : at + k + 2] = (1.0, -2.0, 1.0)
                rows.append(row)
        else:
            middle = knots - 0.5 * np.diff(knots, prepend=0.0)
            of = later[0] + np.minimum(np.searchsorted(later[1], middle), later[1].size - 1)
            for k in range(n - 1):
                row = np.zeros(size)
                row[at + k : at + k + 2] += (-1.0, 1.0)
                row[of[k]] += 1.0
                row[of[k + 1]] -= 1.0
                rows.append(row)
        at += n
    bend = point.model.stage(Bend.id)
    if isinstance(bend, Bend) and Bend.id not in point.fixed and point.tables:
        for curved in Bend.curvature() * (SECOND / (CURVED * bend["over_v"])):
            row = np.zeros(size)
            row[at : at + curved.size] = curved
            rows.append(row)
    return np.array(rows).reshape(-1, size)
