"""Refits: elements by least squares, stage parameters by generalised least squares.

Elements are fitted for prediction, with equal weights. Parameters of causes are fitted in the
whitened space, with everything that the base, the fine thresholds and the dictionary could
explain left open, so that their intervals hold although the base is never exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from piezo_rig.causes.cause import Cause
from piezo_rig.chain import Model
from piezo_rig.diagnosis.columns import near_to, numbers_of
from piezo_rig.diagnosis.compliances import TOGETHER, element_step, smooth_weight
from piezo_rig.diagnosis.context import at_one_frequency
from piezo_rig.diagnosis.fit import Point, smoothness
from piezo_rig.diagnosis.likelihood import Likelihood
from piezo_rig.diagnosis.linear import Linear
from piezo_rig.diagnosis.reduction import Reduced, reduce
from piezo_rig.diagnosis.space import Space
from piezo_rig.errors import InputError

FloatArray = NDArray[np.float64]
STEPS = 5
HALVED = 8
SETTLED = 0.05  # standard errors
ANEW = 0.1  # examples by which a parameter has moved when the tangent is taken anew
AGAIN = 0.05  # of the squared error, by which it changes while the tangent is taken anew later
ASTRAY = 3.0  # squared error after a step, of that before, that is not followed
STILL = 0.005  # of the squared error, by which a settled one changes at most beside such a bend
GROWN = 1.01  # the same beside a bend that is fitted by least squares
OTHER = 0.05  # of the mean compliance, by which one of them has moved then
UNKNOWN = 1e6  # variance of what no data know, in squared examples
PLAUSIBLE = 25.0  # examples that there may be of a bend


@dataclass(frozen=True, eq=False)
class Fitted:
    """A refitted point.

    Attributes
    ----------
    point, space : the point, and the space it was fitted in
    covariance : of the stage parameters, shape (q, q)
    scales : variances of fine thresholds and dictionary
    evidence : log of the marginal likelihood, everything but the stage parameters integrated;
        -inf in a bare space
    """

    point: Point
    space: Space
    covariance: FloatArray
    scales: tuple[float, float]
    evidence: float = -np.inf

    @property
    def linear(self) -> Linear:
        """The Gram matrices about the point; the space is settled anew if they have gone."""
        known = self.space.kept(self.point)
        if known is None:
            settle(self.space, self.point)
            known = self.space.linear(self.point)
            self.space.keep(self.point, known)
        return known

    @property
    def parts(self) -> list[object]:
        """Itself and what it is made from, down to the stages: see `abreast`."""
        return [self, self.point, self.point.model, *self.point.model.stages]


def parameter_step(
    point: Point,
    linear: Linear,
    scales: tuple[float, float],
    pieces: Sequence[int] | None = None,
    held: bool = False,
) -> tuple[FloatArray, FloatArray]:
    """Generalised least squares step (q,) of the stage parameters, and their covariance.

    ``held`` : optional parameters stay where they are
    """
    n, q = point.linear, len(point.sizes)
    if q == 0:
        return np.zeros(0), np.zeros((0, 0))
    reduced = reduce(linear, pieces, free=range(n, n + q))
    columns = reduced.trials[:, -q:]
    information, right = _information(reduced, columns, scales)
    values = point.values()[n:]
    for j, (id, name) in enumerate(point.names):
        stage = point.model.stage(id)
        if isinstance(stage, Cause) and name in stage.priors:
            mean, spread = stage.priors[name]
            information[j, j] += spread**-2
            right[j] += (mean - values[j]) / spread**2
        elif stage is not None and name in stage.optional:
            information[j, j] += point.sizes[j][2] ** -2  # damped: data may not know it
    size = np.array([s for _, _, s in point.sizes])
    scaled = information * np.outer(size, size)
    if not np.trace(scaled) > 0.0:  # these pieces know nothing of it, as of a level never reached
        return np.zeros(q), UNKNOWN * np.diag(size**2)
    scaled += 1e-12 * np.trace(scaled) / q * np.eye(q)
    covariance = np.asarray(np.linalg.inv(scaled), float) * np.outer(size, size)
    free = np.array([not (held and _optional(point, id, n)) for id, n in point.names])
    bounds = np.array([_limits(point, id, n) for id, n in point.names]) - values[:, None]
    step = size * _bounded(scaled, size * right, free, bounds / np.abs(size)[:, None])
    of_base = [j for j, (id, _) in enumerate(point.names) if _of_base(point, id)]
    if of_base:
        plain = _with_base(point, linear, pieces, step, of_base)
        step[of_base] = np.clip(plain, *bounds[of_base].T)
    return step, covariance


def _with_base(
    point: Point, linear: Linear, pieces: Sequence[int] | None, step: FloatArray, of_base: list[int]
) -> FloatArray:
    """Step of the numbers that belong to the base: by what the compliances are fitted by.

    Where powers of the drive are projected off hardly anything is left to know them by.
    """
    n, weight = point.linear, smooth_weight(point, linear, pieces)
    mine = [*range(n), *(n + j for j in of_base)]
    others = [j for j in range(step.size) if j not in of_base]
    raw = linear.raw(pieces)
    rows = smoothness(point)[:, :n]
    gram, right = raw[np.ix_(mine, mine)], raw[mine, -1]
    right = right - raw[np.ix_(mine, [n + j for j in others])] @ step[others]
    gram[:n, :n] += weight * rows.T @ rows
    right[:n] -= weight * rows.T @ (rows @ point.values()[:n])
    count = linear.count.sum() if pieces is None else linear.count[list(pieces)].sum()
    left = TOGETHER * raw[-1, -1] / max(count, 1.0)
    for k, j in enumerate(of_base, n):  # what a table does as well is left to it
        own = left / (PLAUSIBLE * point.sizes[j][2]) ** 2
        gram[k, k] += own
        right[k] -= own * point.values()[n + j]
    gram += 1e-12 * np.diag(np.diag(gram)) + 1e-300 * np.eye(len(mine))
    return np.asarray(np.linalg.solve(gram, right)[n:])


def _of_base(point: Point, id: str) -> bool:
    stage = point.model.stage(id)
    return isinstance(stage, Cause) and stage.of_base


def _bounded(
    information: FloatArray, right: FloatArray, free: NDArray[np.bool_], bounds: FloatArray
) -> FloatArray:
    """The step (q,) of those that are free, within bounds (q, 2).

    One that would go beyond stays there, and the others are solved for anew: clipped by itself it
    would leave them where they were to make up for it.
    """
    step, moving = np.zeros(right.size), free.copy()
    while moving.any():
        still = ~moving
        step[moving] = np.linalg.solve(
            information[np.ix_(moving, moving)],
            right[moving] - information[np.ix_(moving, still)] @ step[still],
        )
        beyond = moving & ((step < bounds[:, 0]) | (step > bounds[:, 1]))
        if not beyond.any():
            break
        step[beyond] = np.clip(step, *bounds.T)[beyond]
        moving &= ~beyond
    return step


def _limits(point: Point, id: str, name: str) -> tuple[float, float]:
    """Physical limits of a parameter."""
    stage = point.model.stage(id)
    if isinstance(stage, Cause) and name in stage.limits:
        return stage.limits[name]
    return -np.inf, np.inf


def _optional(point: Point, id: str, name: str) -> bool:
    stage = point.model.stage(id)
    return stage is not None and name in stage.optional


def _information(
    reduced: Reduced, columns: FloatArray, scales: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    factor = reduced.covariance.factor(scales)
    if factor is None:
        raise np.linalg.LinAlgError("the covariance has no factor")
    both = np.column_stack([columns, reduced.z])
    n = len(factor)
    both[:n], _ = lapack.dtrtrs(factor, both[:n], lower=1)
    white, z = both[:, :-1], both[:, -1]
    return white.T @ white, white.T @ z


def refit(
    space: Space, point: Point, steps: int = STEPS, held: bool = False,
    near: Linear | None = None, anew: str = "", plain: bool = False,
) -> Fitted:
    """Gauss-Newton on all free numbers from a start; scales are profiled on the way.

    What the assumed laws of the model's causes leave open is in the covariance.

    Parameters
    ----------
    held : optional parameters, as a law's reach, stay where they are
    near : about a point so near that its tangent serves as well
    anew : but for the parameters of this stage
    plain : least squares, as if nothing but noise would be left
    """
    settle(space, point)
    linear = space.about(point, near, anew) if near else space.linear(point)
    scales, covariance = (0.0, 0.0), np.zeros((0, 0))
    begun, q = point, len(point.sizes)
    of_base = any(_of_base(point, id) for id, _ in point.names)
    for step in range(steps):
        if point.values().size == 0:
            break
        if q:
            # a fixed model shows effects far above the noise: what the first, linear look leaves
            # of them is no mismatch
            if not plain and (step in (0, 2) or (step == 1 and point.fixed)):
                scales = _likelihood(point, linear)[0].best_scales(range(-q, 0))
            change, covariance = parameter_step(point, linear, scales, held=held)
            change = _within(point, change)
        else:
            change = np.zeros(0)
        before = square_of(linear)
        point, change, linear = _moved(space, point, linear, change)
        settled = bool(q == 0 or np.all(np.abs(change) <= SETTLED * np.sqrt(np.diag(covariance))))
        off = abs(square_of(linear) - before)
        moving = step > 1 and off > AGAIN * before
        settled &= not of_base or off < STILL * before
        if q != 0 and (moving or (step == 1 and _far(point, begun))):
            settle(space, point)
            linear = space.linear(point)
        if settled and step > 0:
            break
    if space.bare:  # whose likelihood nobody asks for
        return Fitted(point, space, covariance, scales)
    likelihood, columns = _likelihood(point, linear)
    used = [c for c, (id, n) in zip(columns, point.names, strict=True)
            if not (held and _optional(point, id, n))]  # fmt: skip
    evidence = likelihood.evidence(used)
    space.keep(point, linear)
    return Fitted(point, space, covariance, scales, evidence)


def gained(fitted: Fitted, here: Fitted) -> float:
    """Log-likelihood that a fit says more than another one, by what it may be wrong by itself.

    A model with a trend of its own leaves the dictionary none: what the dictionary's trends say
    beside the other is no evidence against it.
    """
    linear, unknown = here.linear, fitted.linear.unknown
    if unknown is None or linear.unknown is not None:
        return fitted.evidence - here.evidence
    point = here.point
    without, columns = _likelihood(point, replace(linear, unknown=unknown, axes={}))
    with_them, _ = _likelihood(point, linear)
    less = with_them.evidence(columns) - without.evidence(columns)
    return fitted.evidence - here.evidence + less


def refit_either_way(space: Space, point: Point) -> Fitted:
    """Refitted from a start, optional parameters held.

    A model that is held shows whole effects. Where they go like what it may get wrong, a refit
    that reckons with that may come to rest far from where it would find nothing wrong: it begins
    once more where plain least squares ends.
    """
    fitted = refit(space, point, held=True)
    if not point.fixed:
        return fitted
    there = refit(space, point, held=True, plain=True).point
    return max(fitted, refit(space, there, held=True), key=lambda f: f.evidence)


def wholly(space: Space, point: Point) -> Fitted:
    """Refitted with optional parameters, then held for a fair comparison."""
    return refit(space, refit(space, point).point, steps=1, held=True)


def square_of(linear: Linear) -> float:
    """Squared error over all samples, um^2."""
    return float(linear.raw_residual[:, -1].sum())


def _far(point: Point, begun: Point) -> bool:
    """Whether a tangent at the begin of a refit does not serve any more."""
    n, c = point.linear, point.compliances
    before = begun.values()
    moved = np.abs(point.values() - before)
    sizes = np.array([abs(size) for *_, size in point.sizes])
    other = c and np.max(moved[:c]) > OTHER * np.mean(np.abs(before[:c]))
    return bool(other or np.any(moved[n:] > ANEW * sizes))


def settle(space: Space, point: Point) -> None:
    """Bring the columns of a space to a model, and what its assumed laws leave open."""
    space.first_rise, space.held = point.has_first_rise, bool(point.fixed)
    space.prepare(point.model)
    lawful = [s for s in point.model.stages if isinstance(s, Cause) and s.law]
    key = tuple(s.id for s in point.model.stages), tuple(numbers_of(s) for s in lawful)
    if space.law_of is None or space.law_of[0] != key[0] or not near_to(space.law_of[1], key[1]):
        space.law, space.law_of = laws_of(space, point.model), key


def _likelihood(point: Point, linear: Linear) -> tuple[Likelihood, range]:
    """About a point, the stage parameters handed on as the last columns."""
    n, q = point.linear, len(point.sizes)
    return Likelihood(reduce(linear, free=range(n, n + q))), range(-q, 0)


def changed_um(
    space: Space, before: Model, after: Model, since_turned: bool = False
) -> float:
    """Rms of what a change of model does to the displacement, blocks centred.

    ``since_turned`` : in every half loop since it began, without what turns have added up to
    """
    square, count, data = 0.0, 0.0, space.together
    moved = data.predicted(after) - data.predicted(before)
    if since_turned:
        moved = moved - moved[data.turned]
    moved = moved[data.inside]
    for index, g in enumerate(space.groups.groups):
        change = moved[data.part(index)]
        for (a, b), cells in zip(space.groups.edges(g), space.groups.cells(g), strict=True):
            square += float(np.sum(cells.centred(change[None, a:b]) ** 2))
            count += float(cells.share.sum())
    return float(np.sqrt(square / max(count, 1.0)))


def laws_of(space: Space, model: Model) -> FloatArray:
    """Variance of every dictionary column that the causes' assumed laws leave open, um^2."""
    out = np.zeros(len(space.tags))
    one = at_one_frequency(space.groups)
    for stage in model.stages:
        if not isinstance(stage, Cause) or not stage.law:
            continue
        less = model.without(stage.id)
        if not playable(space, less):
            continue
        # columns that begin anew at every turn know nothing of what turns have added up to
        size = min(changed_um(space, less, model, since) for since in (False, True))
        assumed = {**stage.at_one_frequency, **stage.assumed} if one else stage.assumed
        for k, tag in enumerate(space.tags):
            out[k] += (assumed.get(tag, 0.0) * size) ** 2
    return out


def _moved(
    space: Space, point: Point, linear: Linear, change: FloatArray
) -> tuple[Point, FloatArray, Linear]:
    """The point after a step, with its residual; a shorter one where the whole leads astray.

    That is where it cannot be played, or leaves far more than before: what is linear about a
    level, or about a mode that rings, is not so for long. Beside a bend the compliances follow a
    part of their way only, where all of it leads astray with the shortest step.
    """
    n = point.linear
    of_base = any(_of_base(point, id) for id, _ in point.names)
    most = GROWN if of_base else ASTRAY
    for partly in (False, True) if of_base else (False,):
        by, follow = change, element_step(point, linear, None, change)
        for _ in range(HALVED):
            values = point.values()
            values[n:] += by
            values[:n] += follow if partly else element_step(point, linear, None, by)
            there = point.moved(values)
            if playable(space, there.model, whole=True):
                left = space.with_residual(linear, there)
                if not by.size or square_of(left) < most * square_of(linear):
                    return there, by, left
            by, follow = 0.5 * by, 0.5 * follow
    return point, np.zeros_like(change), linear


def playable(space: Space, model: Model, whole: bool = False) -> bool:
    """Whether a model can follow all drives of the data; ``whole`` : unthinned."""
    try:
        if whole:
            for group in space.groups.groups:
                group.predicted(model)
        else:
            space.together.predicted(model)
    except InputError:
        return False
    return True


def _within(point: Point, change: FloatArray) -> FloatArray:
    """A step kept within physical limits and within a hundred examples."""
    values = point.values()[point.linear :]
    most = 300.0 * np.array([abs(size) for *_, size in point.sizes])
    bounds = np.array([_limits(point, id, n) for id, n in point.names])
    return np.asarray(np.clip(values + np.clip(change, -most, most), *bounds.T) - values)
