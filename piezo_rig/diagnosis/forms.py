"""Where a refit should begin: further out for large effects, and at which form and reach for laws.

A refit goes downhill from where a linear look put it. That look was taken while other causes were
missing, which the new one then seemed to make up for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes.cause import NEAR, Cause
from piezo_rig.chain import Stage
from piezo_rig.diagnosis.abreast import abreast
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.likelihood import Likelihood
from piezo_rig.diagnosis.linear import Linear
from piezo_rig.diagnosis.reduction import reduce
from piezo_rig.diagnosis.refit import Fitted, playable, refit, refit_either_way, settle
from piezo_rig.diagnosis.space import Space
from piezo_rig.errors import InputError

FloatArray = NDArray[np.float64]
ONCE_MORE = 4
BETTER = 3.0  # log-likelihood by which a refit from further out must be better
VERY_LARGE = 1e5  # the same that promises an effect which may be nothing like a small one
LARGE = 300.0  # the same above which a law was begun at the right size, and no law recovers from
PLAIN = 20.0  # log-likelihood above which all forms of a law are refitted
PARABOLAS, SETTLED, TOP = 6, 1.0, 0.05  # at most so many; gains in log-likelihood that end them
FURTHER, FURTHER_BY = 4, 1.4
WIDE = 1.25  # between lengths from which an effect that lasts is begun
WITHIN = 0.4  # of a sample
LOOKED_AT = 8  # starts of a very large effect that are fitted, of many
SHORTEST, WIDER, REACHES = 0.006, 1.19, 21  # its reach: of the travel, step, how many
STEEP = 0.4  # of the mean spring constant, by the whole range of the drive
ALIKE = 6  # such steps to either side, for the reach of another form
LIKELIEST = 2  # of each form, that are refitted
ELSEWHERE, COARSER = 6, 2  # of all, where none of them fits well; every so many reaches
BESIDE = 0.02  # samples
HELD, BY = 0.002, 0.25  # of a kink: held up at it, on one of its sides, samples
BEYOND = (4.0, 8.0, 16.0, 32.0)  # times the noise of a sample
UNLIKELY = 50.0  # log-likelihood that a form must not lack before its best place is looked for
FADES = 4.0  # log-likelihood by which a law that fades out must be better
CARRIES = 15.0  # the same of one that hangs on two half loops, by which it may look like another


def begun_best(space: Space, point: Point, id: str, example: Stage, promised: float) -> Point:
    """Where to begin with a cause of which there may be far more than in its small example.

    At what the linear look made of it, at about the length of the example that fitted best, or
    where very large ones are: whichever one step from there leads to the best place.
    """
    stage = point.model.stage(id)
    if not isinstance(stage, Cause):
        return point
    starts: list[Stage] = [stage]
    if stage.lasting and example[stage.lasting] >= WITHIN / space.groups.rate:  # else it is linear
        length = float(np.copysign(example[stage.lasting], stage[stage.lasting]))
        low, high = stage.limits[stage.lasting]
        starts += [
            stage.with_values(**{stage.lasting: seconds})
            for seconds in (length / WIDE, length, length * WIDE) if low < seconds < high
        ]  # fmt: skip
    large = stage.at_large() if promised > VERY_LARGE or stage.of_base else []
    if large:
        large = looked_at(space, point, large)
        worth = _begun_with(space, point, large, _as_begun)
        near = looked_at(space, point, stage.at_large(near=large[int(np.argmax(worth))]))
        worth = _begun_with(space, point, [*starts, *near], _as_begun)
        return replace(point, model=point.model.with_stage([*starts, *near][int(np.argmax(worth))]))
    if len(starts) == 1:
        return point
    worth = _begun_with(space, point, starts, _one_step)
    return replace(point, model=point.model.with_stage(starts[int(np.argmax(worth))]))


def looked_at(
    space: Space, point: Point, starts: list[Stage], most: int = LOOKED_AT
) -> list[Stage]:
    """Those of many starts that a linear look, each at its whole size, finds likeliest."""
    if len(starts) <= most:
        return starts
    less = point.without(starts[0].id)
    settle(space, less)
    starts = [s for s in starts if playable(space, less.model.with_stage(s))]
    pairs = [(less.model, less.model.with_stage(s)) for s in starts]
    likelihood = Likelihood(reduce(space.linear(less, pairs)))
    worth = [likelihood.evidence([k]) for k in range(len(starts))]
    return [starts[k] for k in np.argsort(worth)[::-1][:most]]


def _begun_with(
    space: Space, point: Point, starts: Sequence[Stage], worth: Callable[[Space, Point], float]
) -> list[float]:
    """What a stage is worth, start by start."""
    points = [replace(point, model=point.model.with_stage(s)) for s in starts]
    made = [partial(worth, space, p) for p in points]
    return abreast(space, made, [point, point.model, *point.model.stages])


def _as_begun(space: Space, point: Point) -> float:
    """Evidence with everything linear fitted anew; none where it cannot be played."""
    try:
        return refit(space, point, steps=0, held=True).evidence
    except (InputError, np.linalg.LinAlgError):
        return -np.inf


def _one_step(space: Space, point: Point) -> float:
    """Evidence a step further, by the columns at hand; none where that cannot be played."""
    try:
        with space.as_it_is():
            return refit(space, point, steps=1, held=True).evidence
    except (InputError, np.linalg.LinAlgError):
        return -np.inf


def as_late(space: Space, fitted: Fitted, id: str) -> Fitted:
    """A delay or a lag by columns that are as late as itself; others as they are."""
    stage = fitted.point.model.stage(id)
    if not isinstance(stage, Cause) or not stage.lasting:
        return fitted
    return refit(space, fitted.point, steps=1, held=True)


def in_another_form(space: Space, fitted: Fitted, id: str) -> Fitted:
    """In whichever form says plainly more."""
    stage = fitted.point.model.stage(id)
    for form in stage.otherwise() if isinstance(stage, Cause) else []:
        other = begun_in(space, fitted, form)
        needed = FADES
        if "carries" in form.parameters:
            needed = CARRIES if form["carries"] > 0.0 else -CARRIES
        if other is not None and other.evidence > fitted.evidence + needed:
            fitted = other
    return fitted


def begun_in(space: Space, fitted: Fitted, form: Stage) -> Fitted | None:
    """Refitted with a stage in another form; None where it cannot be played."""
    other = at_values(space, fitted, form.id, {n: form[n] for n in form.parameters})
    if other is fitted:
        return None
    if isinstance(form, Cause) and form.scanned[0] in form.parameters:
        near = other.evidence > fitted.evidence - UNLIKELY
        return summit(space, other, form.id) if near else other
    return refit_either_way(space, other.point)


def further(space: Space, fitted: Fitted, id: str) -> Fitted:
    """A large effect once more from further out: what a small one mimics may hold it back."""
    for _ in range(FURTHER):
        point = fitted.point
        stage = point.model.stage(id)
        names = [n for i, n in point.names if i == id]
        if stage is None or not names:
            break
        rest = stage.neutral.get(names[0], 0.0)
        value = rest + FURTHER_BY * (stage[names[0]] - rest)
        limits = stage.limits if isinstance(stage, Cause) else {}
        value = float(np.clip(value, *limits.get(names[0], (-np.inf, np.inf))))
        moved = point.model.with_stage(stage.with_values(**{names[0]: value}))
        start = replace(point, model=moved)
        try:
            if not isinstance(stage, Cause) or stage.near >= NEAR:
                with space.as_it_is():  # a look by the same columns, where they serve so far
                    there = refit(space, start, held=True)
                if there.evidence < fitted.evidence + BETTER:
                    break
            there = refit(space, start, held=True)
        except (InputError, np.linalg.LinAlgError):
            break  # nothing is left to fit so far out, as beyond a level that is reached
        if there.evidence < fitted.evidence + BETTER:
            break
        fitted = there
    return fitted


def converged(space: Space, fitted: Fitted) -> Fitted:
    """Refitted until nothing more is gained: what comes next is compared with this.

    After a large effect a few steps from where it was put in are not enough, and whatever is tried
    then is refitted as well, and would be paid for that.
    """
    for _ in range(ONCE_MORE):
        there = refit(space, fitted.point, held=True, near=fitted.linear)
        if there.evidence < fitted.evidence + BETTER:
            break
        fitted = there
    return fitted


def beside_kinks(space: Space, fitted: Fitted, id: str) -> Fitted:
    """The best refit from beside where a descent may be held up.

    That is a kink of the effect at a whole sample, or a level that was taken for too near: elements
    have then been bent to stay below it.
    """
    stage = fitted.point.model.stage(id)
    if not isinstance(stage, Cause) or not (stage.kinked or stage.bending):
        return fitted
    if stage.kinked:
        name, step_s = stage.kinked, 1.0 / space.groups.rate
        whole = np.round(stage[name] / step_s)
        off = float(stage[name] / step_s - whole)
        sides = [s for s in (-BESIDE, BESIDE) if abs(off) < HELD or (abs(off) < BY and s * off < 0)]
        begins = [float((whole + s) * step_s) for s in sides]
    else:
        name, noise_um = stage.bending, 1e-3 * space.sample_noise_nm
        begins = [stage[name] + float(np.copysign(b * noise_um, stage[name])) for b in BEYOND]
    tried = abreast(space, [
        partial(_begun_at, space, fitted, id, {name: begin}) for begin in begins
    ], fitted.parts)  # fmt: skip
    return max([fitted, *tried], key=lambda f: f.evidence)


def _begun_at(space: Space, fitted: Fitted, id: str, values: Mapping[str, float]) -> Fitted:
    """Refitted from there, and once more from where that led: evidences are of tangents there."""
    there = at_values(space, fitted, id, values)
    if there is fitted:
        return fitted
    return refit(space, there.point, steps=1, held=True)


def reached(space: Space, fitted: Fitted, id: str, than: Fitted) -> Fitted:
    """The reach of a law where the evidence is largest, by parabolas over its logarithm.

    So with any parameter that a cause wants scanned. The form and the reach of a law that is plain
    to see are looked for anew: those of its beginning were chosen when everything else still had
    to make up for it.
    """
    stage = fitted.point.model.stage(id)
    if not isinstance(stage, Cause) or stage.scanned[0] not in stage.parameters:
        return fitted
    if "taper" not in stage.parameters:
        return summit(space, fitted, id)

    def tied(begun: Fitted) -> Fitted:
        kept = _tied(space, begun, id)
        there = summit(space, kept, id)
        if kept is begun:
            return there
        free = summit(space, begun, id)  # there they may say less, though not where it was begun
        return free if free.evidence > there.evidence - FADES else there

    if fitted.evidence > than.evidence + PLAIN:
        best = max(abreast(space, [partial(tied, f) for f in _forms(space, fitted, id, than)],
                           fitted.parts), key=lambda f: worth_of(f, id))  # fmt: skip
    else:
        best = summit(space, fitted, id)
    if "slope" not in stage.parameters or best.evidence > than.evidence + LARGE:
        return best
    steep = [partial(tied, f) for f in _steep(space, best, id, than)]
    return max([best, *abreast(space, steep, fitted.parts)], key=lambda f: worth_of(f, id))


def _steep(space: Space, fitted: Fitted, id: str, than: Fitted) -> list[Fitted]:
    """The likeliest begins of a law as steep as it can be, one of each form that can be played.

    A spring that hardens gives way less and less: no descent leads there from a small slope.
    """
    stage = fitted.point.model.stage(id)
    assert isinstance(stage, Cause)
    slope = float(np.copysign(STEEP / space.groups.travel_um, stage["slope"]))
    steep = stage.with_values(slope=slope)
    assert isinstance(steep, Cause)
    tried, likelihood = _scanned(space, steep, than)
    worth = _gained(likelihood, len(tried))
    found = _from(space, fitted, id, ("reach", "taper", "slope"), tried, worth)
    each = [max(same, key=lambda f: f.evidence) for same in found]
    return [f for f in each if f.evidence > fitted.evidence - LARGE]


def taper_of(fitted: Fitted, id: str) -> float:
    """How a law ends."""
    stage = fitted.point.model.stage(id)
    assert stage is not None
    return stage["taper"]


def carries(fitted: Fitted, id: str) -> bool:
    """Whether it keeps its force over turning points: see `Reaching`."""
    stage = fitted.point.model.stage(id)
    return stage is not None and "carries" in stage.parameters and stage["carries"] > 0.0


def worth_of(fitted: Fitted, id: str) -> float:
    """Log-likelihood; a law that fades out, or hangs on two half loops, must say more."""
    dear = FADES * (taper_of(fitted, id) > 0.0) + CARRIES * carries(fitted, id)
    return fitted.evidence - dear


def walked(space: Space, fitted: Fitted, id: str) -> Fitted:
    """A large effect with the level that a cause wants walked to, where it has one."""
    stage = fitted.point.model.stage(id)
    if not isinstance(stage, Cause) or stage.walked[0] not in stage.parameters:
        return fitted
    return summit(space, fitted, id, stage.walked)


def summit(
    space: Space, fitted: Fitted, id: str, over: tuple[str, float] | None = None
) -> Fitted:
    """Where the evidence is largest over the scanned parameter, or ``over`` another, from where it
    stands.
    """
    stage = fitted.point.model.stage(id)
    assert isinstance(stage, Cause)
    name, factor = over or stage.scanned
    known = {stage[name]: fitted}
    step, near = np.log(factor), fitted.linear
    for _ in range(PARABOLAS):
        best = max(known, key=lambda r: known[r].evidence)
        before = known[best].evidence
        for r in (best * np.exp(-step), best * np.exp(step)):
            if not any(abs(np.log(r / k)) < 0.3 * step for k in known):
                known[r] = at_values(space, known[best], id, {name: r}, near)
        x = np.log(sorted(known))
        y = np.array([known[r].evidence for r in sorted(known)])
        i = int(np.clip(np.argmax(y), 1, x.size - 2))
        inside, as_foretold = 0 < int(np.argmax(y)) < y.size - 1, False
        a, b, c = np.polyfit(x[i - 1 : i + 2] - x[i], y[i - 1 : i + 2], 2)
        if a < 0 and abs(b) < -4.0 * a * step:
            r, top = float(np.exp(x[i] - b / (2.0 * a))), float(c - b * b / (4.0 * a))
            as_foretold = top < y.max() + TOP  # nothing to be gained there
            if not as_foretold and not any(abs(np.log(r / k)) < 1e-3 for k in known):
                known[r] = at_values(space, known[best], id, {name: r}, near)
                as_foretold = abs(known[r].evidence - top) < SETTLED
        if inside:
            if as_foretold or max(f.evidence for f in known.values()) < before + SETTLED:
                break
            step *= 0.5
    likeliest = max(known.values(), key=lambda f: f.evidence)
    there = refit(space, likeliest.point, steps=2, held=True)
    return there if there.evidence > fitted.evidence - BETTER else fitted


def _forms(space: Space, fitted: Fitted, id: str, than: Fitted) -> list[Fitted]:
    """The best of each of a law's forms, looked for over all reaches that it may have.

    The evidence has several summits over the reach, so all are scored about the model without the
    law, each with what the law does at its fitted size; the best are refitted. The thesis's law
    ends where an element gives way; one that fades out must say more.
    """
    start = fitted.point.model.stage(id)
    assert isinstance(start, Cause)
    tried, likelihood = _scanned(space, start, than)
    worth = _gained(likelihood, len(tried))
    found = _from(space, fitted, id, ("reach", "taper"), tried, worth)
    best = [fitted, *(f for same in found for f in same)]
    return [
        max(same, key=lambda f: f.evidence)
        for form in start.tapers if (same := [f for f in best if taper_of(f, id) == form])
    ]  # fmt: skip


def elsewhere(space: Space, fitted: Fitted, id: str, than: Fitted) -> list[Fitted]:
    """A law in each of its forms that fit best by least squares, wherever each may begin.

    The evidence reckons with whatever a base may be wrong by. Where a law is not quite that of the
    actuator, that explains what is left either way, and the evidence hardly asks how much it is.
    """
    start = fitted.point.model.stage(id)
    if not isinstance(start, Cause) or "taper" not in start.parameters:
        return []
    best: list[tuple[float, Stage]] = []
    for form in (start, *start.otherwise()):
        assert isinstance(form, Cause)
        tried, likelihood = _scanned(space, form, than, COARSER)
        worth = [likelihood.plain([k]) for k in range(len(tried))]
        best += [(worth[own[0]], tried[own[0]]) for own in _likeliest(tried, worth)]
    best.sort(key=lambda b: -b[0])

    def begun(form: Stage) -> list[Fitted]:
        there = at_values(space, fitted, id, {n: form[n] for n in form.parameters})
        try:
            return [there, refit(space, there.point, held=True, plain=True)]
        except (InputError, np.linalg.LinAlgError):  # least squares leads to what cannot be played
            return [there]

    found = abreast(space, [partial(begun, s) for _, s in best[:ELSEWHERE]], fitted.parts)
    return [f for both in found for f in both]


def _scanned(
    space: Space, start: Cause, than: Fitted, every: int = 1
) -> tuple[list[Stage], Likelihood]:
    """A law at ``every`` so many of its reaches and in all forms, and how likely each is about the
    model without it.
    """
    less = than.point.model
    reaches = space.groups.travel_um * SHORTEST * WIDER ** np.arange(0, REACHES, every)
    tried = [start.with_values(reach=float(r), taper=f) for f in start.tapers for r in reaches]
    tried = [s for s in tried if playable(space, less.with_stage(s))]
    settle(space, than.point)
    pairs = [(less, less.with_stage(s)) for s in tried]
    return tried, Likelihood(reduce(space.linear(than.point, pairs)))


def _gained(likelihood: Likelihood, count: int) -> list[float]:
    """What a linear look says that each of so many gains."""
    without = likelihood.evidence(())
    return [likelihood.evidence([k]) - without for k in range(count)]


def _from(
    space: Space, fitted: Fitted, id: str, names: Sequence[str], tried: Sequence[Stage],
    worth: Sequence[float],
) -> list[list[Fitted]]:
    """Refits, form by form, from where a law's likeliest tries have some of its parameters."""
    by_form, near = _likeliest(tried, worth), fitted.linear
    fits = iter(abreast(space, [
        partial(at_values, space, fitted, id, {n: tried[k][n] for n in names}, near)
        for likeliest in by_form for k in likeliest
    ], fitted.parts))  # fmt: skip
    return [[next(fits) for _ in likeliest] for likeliest in by_form]


def _likeliest(tried: Sequence[Stage], worth: Sequence[float]) -> list[list[int]]:
    """Which of a law's tries say most, form by form; forms that were not tried left out."""
    by_form: dict[float, list[int]] = {}
    for k, s in enumerate(tried):
        by_form.setdefault(s["taper"], []).append(k)
    return [sorted(own, key=lambda k: -worth[k])[:LIKELIEST] for own in by_form.values()]


def most_alike(space: Space, fitted: Fitted, id: str, taper: float) -> float:
    """Reach at which a law that ends otherwise does most nearly what it does now.

    It is a matter of the law alone, as it acts along the furthest of all drives.
    """
    model, stage = fitted.point.model, fitted.point.model.stage(id)
    assert stage is not None
    group = max(space.groups.groups, key=lambda g: float(np.ptp(g.drive_v)))
    less = group.predicted_once(model.without(id))

    def done(form: Stage) -> FloatArray:
        change = group.predicted_once(model.with_stage(form)) - less
        return np.asarray(change - change.mean())

    own = done(stage)
    found: dict[float, float] = {}
    for reach in stage["reach"] * WIDER ** np.arange(-ALIKE, ALIKE + 1):
        try:
            other = done(stage.with_values(reach=float(reach), taper=taper))
        except InputError:
            continue
        size = float(np.sqrt((other @ other) * (own @ own)))
        found[float(reach)] = float(own @ other) / max(size, 1e-300)
    return max(found, key=lambda r: found[r], default=stage["reach"])


def _tied(space: Space, fitted: Fitted, id: str) -> Fitted:
    """With loops that the drive closes exactly kept in memory, where the data say so."""
    stage = fitted.point.model.stage(id)
    if stage is None or "ties" not in stage.optional:
        return fitted
    kept = at_values(space, fitted, id, {"ties": 1.0})
    return kept if kept.evidence > fitted.evidence + FADES else fitted


def at_values(
    space: Space, fitted: Fitted, id: str, values: Mapping[str, float], near: Linear | None = None
) -> Fitted:
    """Refitted with parameters of a stage moved and held; as before if it cannot be played.

    ``near`` : columns of all but that stage's parameters
    """
    stage = fitted.point.model.stage(id)
    assert stage is not None
    moved = fitted.point.model.with_stage(stage.with_values(**values))
    try:
        return refit(space, replace(fitted.point, model=moved), steps=1, held=True, near=near,
                     anew=id)
    except (InputError, np.linalg.LinAlgError):
        return fitted
