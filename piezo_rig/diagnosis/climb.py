"""The ladder: which causes the data ask for, one after the other.

Forward selection: every cause of the catalogue is scored against the refitted model; the best is
accepted if its family-wise chance is below 1 %, the model is extended, refitted with all
parameters and linearised anew. Afterwards members that are no longer needed are dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause, Context
from piezo_rig.chain import Model, Stage
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.likelihood import Likelihood, Reduced, reduce
from piezo_rig.diagnosis.refit import Fitted, covariance_of, refit
from piezo_rig.diagnosis.space import Space
from piezo_rig.errors import InputError

FloatArray = NDArray[np.float64]
LEVEL = 0.01
MOST = 6  # findings
CLOSE, RUN_OFF = 0.4, 4  # share of the best score, and how many are refitted to compare
NEEDED = 1e-4  # a member must differ from nothing at this level
WORSE = 1.001  # held-out error may rise by this
VISIBLE = 3.0  # d' that the largest plausible size must reach, or the cause is not looked for
Tell = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Candidate:
    """One cause in the race, in one or several forms, each with its examples."""

    id: str
    variants: tuple[tuple[Stage, ...], ...]

    def pairs(self, model: Model) -> list[tuple[Model, Model]]:
        """What is to be played with and without, form by form."""
        return [(model, model.with_stage(t)) for form in self.variants for t in form]

    def columns(self, at: int) -> list[list[int]]:
        """Columns of every form, if those of `pairs` begin at ``at``."""
        out = []
        for form in self.variants:
            out.append(list(range(at, at + len(form))))
            at += len(form)
        return out


@dataclass(frozen=True, eq=False)
class Scan:
    """One round of the race.

    Attributes
    ----------
    ids : the causes that were tried
    ratio, p_family : shape (c,)
    refused : cause -> why it was not tried
    """

    ids: tuple[str, ...]
    ratio: FloatArray
    p_family: FloatArray
    excess: FloatArray
    refused: dict[str, str]
    unexplained: tuple[float, float] = (0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Step:
    """One accepted cause, and the model with it."""

    cause: str
    p_value: float
    fitted: Fitted


@dataclass(frozen=True, eq=False)
class Ladder:
    """Everything that was accepted, in order, and the last look at what is left."""

    first: Fitted
    steps: tuple[Step, ...]
    scans: tuple[Scan, ...]
    notes: list[str] = field(default_factory=list)

    @property
    def last(self) -> Fitted:
        return self.steps[-1].fitted if self.steps else self.first


def context_of(space: Space, model: Model) -> Context:
    """What the data are like."""
    slews, longest = [], 0.0
    for g in space.groups.groups:
        seconds = g.time_s[g.loops.stop] - g.time_s[g.loops.start]
        volts = np.abs(g.drive_v[g.loops.stop] - g.drive_v[g.loops.start])
        slews.append(volts[seconds > 0] / seconds[seconds > 0])
        longest = max(longest, float(g.time_s[-1] - g.time_s[0]))
    return Context(
        model,
        space.groups.travel_um,
        space.groups.span_v,
        np.concatenate(slews),
        1.0 / space.groups.rate,
        longest,
    )


def candidates(space: Space, model: Model) -> tuple[list[Candidate], dict[str, str]]:
    """Causes that may be tried on a model, and why others may not."""
    context = context_of(space, model)
    found, refused = [], {}
    for id, kind in CAUSES.items():
        if not issubclass(kind, Cause) or model.stage(id) is not None:
            continue
        if kind.needs_first_rise and not space.groups.has_first_rise:
            refused[id] = "no first rise from rest in the data"
            continue
        if kind.needs_speeds and not _several_speeds(context):
            refused[id] = (
                "all half loops are about equally fast: a delay, a lag of the drive and a loop "
                "that opens with speed cannot be told from each other or from the model's own "
                "loop; several frequencies (rate_sweep) would show it"
            )
            continue
        variants = kind.variants(context)
        if variants:
            found.append(Candidate(id, tuple(tuple(v) for v in variants)))
    return found, refused


def _several_speeds(context: Context) -> bool:
    """Whether half loops differ in speed by a factor of 1.5 or more."""
    moving = context.slews_v_per_s[context.slews_v_per_s > 0.02 * context.slews_v_per_s.max()]
    low, high = np.percentile(moving, [5, 95])
    return bool(high > 1.5 * low)


def scan(
    space: Space, fitted: Fitted, rng: np.random.Generator, barred: dict[str, str] | None = None
) -> tuple[Scan, list[Candidate], Likelihood, dict[str, tuple[list[int], tuple[Stage, ...]]]]:
    """Score every cause against the fitted model."""
    found, refused = candidates(space, fitted.point.model)
    refused |= barred or {}
    found = [c for c in found if c.id not in (barred or {})]
    pairs: list[tuple[Model, Model]] = []
    where: dict[str, list[list[int]]] = {}
    for c in found:
        where[c.id] = c.columns(len(pairs))
        pairs += c.pairs(fitted.point.model)
    linear = space.linear(fitted.point, pairs)
    reduced = reduce(linear)
    kept = []
    for c in found:
        seen = max(_visible(reduced, columns) for columns in where[c.id])
        if seen * CAUSES[c.id].largest < VISIBLE:  # type: ignore[attr-defined]
            refused[c.id] = "these data cannot show it: what it does, the base model can do as well"
        else:
            kept.append(c)
    likelihood = Likelihood(reduced)
    hypotheses = [h for c in kept for h in where[c.id]]
    owners = [i for i, c in enumerate(kept) for _ in where[c.id]]
    if not kept:
        empty = np.zeros(0)
        return Scan((), empty, empty, empty, refused), kept, likelihood, {}
    scored = likelihood.score(hypotheses, owners, rng)
    family = np.minimum(scored.p_value * len(kept), 1.0)
    result = Scan(
        tuple(c.id for c in kept),
        scored.ratio,
        family,
        scored.ratio - 2.0 * scored.null_median,
        refused,
    )
    forms = [form for c in kept for form in c.variants]
    chosen = {
        c.id: (hypotheses[scored.chosen[i]], forms[scored.chosen[i]]) for i, c in enumerate(kept)
    }
    return result, kept, likelihood, chosen


def _visible(reduced: Reduced, columns: list[int]) -> float:
    """d' of one example of its typical size against the noise alone."""
    return float(np.sqrt(np.max(np.sum(reduced.trials[:, columns] ** 2, axis=0))))


def extended(
    space: Space,
    fitted: Fitted,
    candidate: Candidate,
    columns: list[int],
    likelihood: Likelihood,
    trials: Sequence[Stage],
) -> Point:
    """The point with a cause put in at the size that the linear fit gives it."""
    reduced = likelihood.reduced
    scales = likelihood.best_scales(columns)
    sigma = covariance_of(reduced, scales)
    t = reduced.trials[:, columns]
    solved = np.linalg.solve(sigma, np.column_stack([t, reduced.z]))
    gram = t.T @ solved[:, :-1]
    size = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram * np.outer(size, size) + 1e-6 * np.eye(len(columns))
    shares = size * np.linalg.solve(scaled, size * (t.T @ solved[:, -1]))
    kind = CAUSES[candidate.id]
    assert issubclass(kind, Cause)
    stage = kind.begun(trials, shares)
    sizes = list(fitted.point.sizes)
    for name in stage.parameters:
        rest = kind.neutral.get(name, 0.0)
        moved = max(abs(t[name] - rest) for t in trials)
        if moved > 0:
            sizes.append((candidate.id, name, float(moved)))
    return Point(fitted.point.model.with_stage(stage), fitted.point.fixed, tuple(sizes))


def climb(
    space: Space,
    first: Fitted,
    rng: np.random.Generator,
    tell: Tell,
    held_out: Callable[[Fitted], float],
    others: int = 0,
) -> Ladder:
    """Forward selection from a fitted baseline.

    Among causes that are about as likely the one that predicts held-out data best is taken; one
    that predicts them worse than the model without it is refused.

    Parameters
    ----------
    held_out : rms error of a rung on data that its refits did not see
    others : causes that were tried elsewhere (on the raw recordings), for the correction
    """
    fitted = first
    steps: list[Step] = []
    scans: list[Scan] = []
    barred: dict[str, str] = {}
    error = held_out(first)
    while len(steps) < MOST:
        tell(f"scan {len(scans) + 1}")
        result, found, likelihood, chosen = scan(space, fitted, rng, barred)
        scans.append(result)
        if not result.ids:
            break
        family = np.minimum(result.p_family * (len(result.ids) + others) / len(result.ids), 1.0)
        good = np.flatnonzero(family < LEVEL)
        if good.size == 0:
            break
        order = good[np.argsort(-result.excess[good])]
        close = [i for i in order if result.excess[i] >= CLOSE * result.excess[order[0]]][:RUN_OFF]
        trials: list[tuple[float, int, Fitted]] = []
        for i in close:
            candidate = found[i]
            tell(f"refit with {candidate.id}")
            columns, form = chosen[candidate.id]
            try:
                point = extended(space, fitted, candidate, columns, likelihood, form)
                tried = _tried(space, point, candidate.id)
            except InputError:  # it cannot even be played at the size that the data ask for
                tried = None
            if tried is None:
                barred[candidate.id] = (
                    "once refitted it came out at a limit, or no different from nothing"
                )
                continue
            value = held_out(tried)
            if value > WORSE * error:
                barred[candidate.id] = (
                    f"fits, but predicts data that it has not seen worse ({value:.3g} nm "
                    f"against {error:.3g} nm)"
                )
                continue
            trials.append((value, int(i), tried))
        space.first_rise = any(s.has_elements and s.id != "maxwell"
                               for s in fitted.point.model.stages)  # fmt: skip
        if not trials:
            continue
        before, before_error = fitted, error
        error, best, fitted = min(trials, key=lambda t: t[0])
        space.first_rise = any(s.has_elements and s.id != "maxwell"
                               for s in fitted.point.model.stages)  # fmt: skip
        space.prepare(fitted.point.model)
        space.law = laws_of(space, fitted.point.model)
        steps.append(Step(found[best].id, float(family[best]), fitted))
        needless = _needless(fitted, [s.cause for s in steps[:-1]])
        if needless:
            tell(f"refit without {needless}")
            swapped = refit(space, _less(fitted.point, needless))
            value = held_out(swapped)
            new = steps.pop()
            if value < before_error:
                barred[needless] = f"not needed beside {new.cause}, which does the same"
                steps = [s for s in steps if s.cause != needless]
                steps.append(Step(new.cause, new.p_value, swapped))
                error, fitted = value, swapped
            else:
                barred[new.cause] = f"not needed beside {needless}, which does the same"
                error, fitted = before_error, before
            space.law = laws_of(space, fitted.point.model)
            space.prepare(fitted.point.model)
    return Ladder(first, tuple(steps), tuple(scans))


def _needless(fitted: Fitted, causes: list[str]) -> str | None:
    """An earlier member whose parameters are no longer different from doing nothing."""
    values = fitted.point.values()[fitted.point.linear :]
    for cause in causes:
        kind = CAUSES[cause]
        index = [
            j
            for j, (id, name) in enumerate(fitted.point.names)
            if id == cause and name not in getattr(kind, "priors", {})
        ]
        if not index:
            continue
        off = values[index] - [kind.neutral.get(fitted.point.names[j][1], 0.0) for j in index]
        covariance = fitted.covariance[np.ix_(index, index)]
        distance = float(off @ np.linalg.solve(covariance, off))
        if distance < stats.chi2.isf(NEEDED, len(index)):
            return cause
    return None


def _less(point: Point, cause: str) -> Point:
    sizes = tuple(s for s in point.sizes if s[0] != cause)
    return Point(without(point.model, cause), point.fixed, sizes)


def _tried(space: Space, point: Point, id: str) -> Fitted | None:
    """The refitted point; None where the cause came out as doing nothing."""
    space.first_rise = any(s.has_elements and s.id != "maxwell" for s in point.model.stages)
    fitted = refit(space, point)
    if _does_nothing(fitted.point, id):
        return None
    before = space.law
    space.law = laws_of(space, fitted.point.model)
    if np.any(space.law > 0):
        fitted = refit(space, fitted.point, steps=2)
    space.law = before
    return None if _needless(fitted, [id]) else fitted


def without(model: Model, id: str) -> Model:
    """The model less one stage."""
    return model.with_(stages=tuple(s for s in model.stages if s.id != id))


def laws_of(space: Space, model: Model) -> FloatArray:
    """Variance of every dictionary column that the accepted causes' assumed laws leave open."""
    out = np.zeros(len(space.tags))
    for stage in model.stages:
        if not isinstance(stage, Cause) or not stage.law[0]:
            continue
        tags, share = stage.law
        less = without(model, stage.id)
        square = count = 0.0
        for g in space.groups.groups:
            change = g.predicted(model) - g.predicted(less)
            for a, b in g.blocks:
                square += float(np.sum((change[a:b] - change[a:b].mean()) ** 2))
                count += b - a
        size = share * np.sqrt(square / count)
        for k, tag in enumerate(space.tags):
            if tag in tags:
                out[k] += size**2
    return out


def _does_nothing(point: Point, id: str) -> bool:
    stage = point.model.stage(id)
    assert stage is not None
    names = [n for i, n in point.names if i == id]
    kind = type(stage)
    scale = {n: s for i, n, s in point.sizes if i == id}
    if not names:
        return False
    for name in names:  # a law that runs into its limit is not this law
        low, high = getattr(kind, "limits", {}).get(name, (-np.inf, np.inf))
        if not low < stage[name] < high:
            return True
    main = names[0]
    return abs(stage[main] - kind.neutral.get(main, 0.0)) < 1e-3 * scale[main]
