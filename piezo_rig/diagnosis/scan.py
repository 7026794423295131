"""One look at every cause: how likely it is against the model at hand, and how it would begin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.causes.first_spring import FirstSpring
from piezo_rig.chain import Model, Stage
from piezo_rig.diagnosis import dictionary
from piezo_rig.diagnosis.context import context_of
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.likelihood import Likelihood
from piezo_rig.diagnosis.linear import Linear
from piezo_rig.diagnosis.reduction import Reduced, covariance_of, reduce
from piezo_rig.diagnosis.refit import Fitted, playable
from piezo_rig.diagnosis.scores import Scored, score
from piezo_rig.diagnosis.space import CLOCK, Space
from piezo_rig.errors import InputError

FloatArray = NDArray[np.float64]
LEVEL = 0.005  # family-wise chance of a false alarm; at 0.01, 4 or 5 of 270 nulls raised one
LATER = 1e-6  # for each after the first: what it is compared with has laws that are only assumed
CLOSE, RUN_OFF = 0.4, 3  # share of the best score, and how many are refitted to compare
ALIKE = 0.25  # the same of what looks alike but beside corners
VISIBLE = 3.0  # d' that the largest plausible size must reach, or the cause is not looked for


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
    ratio, p_family, excess, null_median : shape (c,); log-likelihood ratio, its family-wise
        chance, what it exceeds twice the nulls' median by, and that median
    refused : cause -> why it was not tried
    """

    ids: tuple[str, ...]
    ratio: FloatArray
    p_family: FloatArray
    excess: FloatArray
    null_median: FloatArray
    refused: dict[str, str]

    def close(self, good: NDArray[np.int64]) -> list[int]:
        """Which of the good ones are refitted to compare, the likeliest first.

        Of those that go by speed the likeliest alone: see `alike`. Bends stand beside what has a
        name, in nobody's place: what bends most looks like one, until it is fitted at its size.
        """
        order = good[np.argsort(-self.excess[good])]
        bends = [int(i) for i in order if of_base(self.ids[i])]
        named = [i for i in order if i not in bends]
        least = CLOSE * max((self.excess[i] for i in named), default=np.inf)
        bends = [i for i in bends if not named or self.excess[i] >= CLOSE * self.excess[order[0]]]
        order = np.array(named, dtype=np.int64)
        close = [int(i) for i in order if self.excess[i] >= least]
        several = [i for i in close if not by_speed(self.ids[i])][:RUN_OFF]
        close = [i for k, i in enumerate(close) if i in several or k < RUN_OFF]
        late = [i for i in close if by_speed(self.ids[i])][1:]
        close = sorted([*bends, *(i for i in close if i not in late)],
                       key=lambda i: -self.excess[i])  # fmt: skip
        if bends:  # they are large: a linear look misleads
            close += [i for i, id in enumerate(self.ids) if of_base(id) and i not in close]
        return close

    def alike(self, good: NDArray[np.int64]) -> list[int]:
        """Which of the good ones may be taken for the likeliest one that goes by speed.

        What a delay, a lag and loops that open with speed do is alike but for some milliseconds
        beside corners, where a linear look says least.
        """
        close, order = self.close(good), good[np.argsort(-self.excess[good])]
        if not any(by_speed(self.ids[i]) for i in close):
            return []
        least = ALIKE * self.excess[order[0]]
        return [int(i) for i in order
                if by_speed(self.ids[i]) and self.excess[i] >= least and int(i) not in close]

    def as_flat(self, good: NDArray[np.int64]) -> list[int]:
        """Which others cut off tips too, where one of those that are refitted does.

        Beside elements that have gone after a tip, a linear look makes little of what a limit
        does there: which of them it is the refits say.
        """
        close = self.close(good)
        if not any(cuts_off(self.ids[i]) for i in close):
            return []
        return [i for i, id in enumerate(self.ids) if cuts_off(id) and i not in close]

    def of_their_kind(self, good: NDArray[np.int64], chance: FloatArray) -> FloatArray:
        """Chances, those of causes that cut off tips the least of them: any of them says that there
        is one, and which it is is for their refits to say. So with what follows the range, where
        something goes by speed. Shape (c,), as that of ``chance``.
        """
        flat = [i for i, id in enumerate(self.ids) if cuts_off(id)]
        out, found = chance.copy(), set(good.tolist())
        if set(flat) & found:
            out[flat] = chance[flat].min()
        fast = [i for i, id in enumerate(self.ids) if by_speed(id) and i in found]
        if fast:
            like = [i for i, id in enumerate(self.ids) if like_speed(id)]
            out[like] = np.minimum(out[like], chance[fast].min())
        return out


def cuts_off(id: str) -> bool:
    """Whether a cause is a limit of the drive or of the sensor."""
    kind = CAUSES[id]
    return issubclass(kind, Cause) and kind.cuts_off


def has_reach(id: str) -> bool:
    """Whether it is a law of what happens up to some way behind a turning point."""
    kind = CAUSES[id]
    return issubclass(kind, Cause) and "reach" in kind.optional


def of_base(id: str) -> bool:
    """Whether it belongs to the base model: found like a cause, but no other name for one."""
    kind = CAUSES[id]
    return issubclass(kind, Cause) and kind.of_base


def by_speed(id: str) -> bool:
    """Whether a cause is told from the model's own loops by speed, or just after corners alone."""
    kind = CAUSES[id]
    return issubclass(kind, Cause) and kind.of_speed


def like_speed(id: str) -> bool:
    """Whether it follows what grows with how fast half loops are."""
    kind = CAUSES[id]
    return issubclass(kind, FirstSpring) and kind.like_speed


def like_range(id: str) -> bool:
    """Whether it grows with how far half loops go, where all have one frequency."""
    kind = CAUSES[id]
    return issubclass(kind, Cause) and bool(kind.at_one_frequency)


def candidates(space: Space, model: Model) -> tuple[list[Candidate], dict[str, str]]:
    """Causes that may be tried on a model, and why others may not."""
    context = context_of(space, model)
    found, refused = [], {}
    for id, kind in CAUSES.items():
        if not issubclass(kind, Cause) or model.stage(id) is not None:
            continue
        if id in space.excluded:
            refused[id] = space.excluded[id]
            continue
        if kind.needs_first_rise and not space.groups.has_first_rise:
            refused[id] = "no first rise of an actuator that is known to have rested"
            continue
        if kind.needs_fixed_model and not space.held:
            refused[id] = (
                "only against a fixed reference model (--baseline MODEL.json): a model that is "
                "refitted takes it in without a trace"
            )
            continue
        if kind.needs_known_order and not all(g.earlier for g in space.groups.groups):
            refused[id] = (
                "only where every recording is said to begin virgin, at a time of its own"
            )
            continue
        if kind.of_speed and not (context.several_speeds or context.corners):
            refused[id] = (
                "all half loops are about equally fast, and turn smoothly: a delay, a lag of the "
                "drive and a loop that opens with speed cannot be told from each other or from the "
                "model's own loop; several frequencies (rate_sweep) would show it, or triangles"
            )
            continue
        variants = kind.variants(context)
        if id in space.longest:  # the shortest says all there is
            most = space.longest[id]
            variants = [v for v in variants if v[0][kind.lasting] <= most] or variants[:1]
        if variants:
            found.append(Candidate(id, tuple(tuple(v) for v in variants)))
    return found, refused


Form = tuple[list[int], tuple[Stage, ...]]  # columns and examples


@dataclass(frozen=True, eq=False)
class Found:
    """A scan with what is needed to take a cause in.

    Attributes
    ----------
    candidates : in the order of ``result.ids``
    linear, likelihood : about the model, all examples as trials
    chosen : cause -> columns and examples of its best form
    forms : cause -> those of every form
    driven : see `Space.driven`
    """

    result: Scan
    candidates: list[Candidate]
    linear: Linear
    likelihood: Likelihood
    chosen: dict[str, Form]
    forms: dict[str, list[Form]]
    driven: FloatArray

    def asking(self, id: str) -> Likelihood:
        """What its forms are compared by. A trend of its own has none of the dictionary's beside
        it, any of which does much of what one does that dies away.
        """
        return self._by_drive if CAUSES[id].locked_to == CLOCK else self.likelihood

    @cached_property
    def _by_drive(self) -> Likelihood:
        if self.linear.unknown is not None:
            return self.likelihood
        return Likelihood(reduce(replace(self.linear, unknown=self.driven, axes={})))

    def at_either_end(self, id: str) -> list[list[Form]]:
        """Its forms by which of their parameters say anything, where that is not always the same:
        levels from below and levels from above.
        """
        ends: dict[frozenset[str], list[Form]] = {}
        for form in self.forms[id]:
            ends.setdefault(_away(form[1]), []).append(form)
        return list(ends.values()) if len(ends) > 1 else []


def _away(trials: Sequence[Stage]) -> frozenset[str]:
    """Parameters of examples that are not what they are where nothing is done."""
    return frozenset(
        n for t in trials if isinstance(t, Cause) for n in t.parameters
        if n in t.sharp and t[n] != t.neutral.get(n, 0.0)
    )


def scan(
    space: Space, fitted: Fitted, rng: np.random.Generator, barred: dict[str, str] | None = None
) -> Found:
    """Score every cause against the fitted model."""
    model = fitted.point.model
    found, refused = candidates(space, model)
    refused |= barred or {}
    found = [c for c in found if c.id not in (barred or {})]
    try:
        linear = space.linear(fitted.point, _pairs(found, model))
    except InputError:  # some example asks for more than the model at hand can do
        found, lost = _playable(space, found, model)
        refused |= dict.fromkeys(lost, "beside the model at hand not even a small one is possible")
        linear = space.linear(fitted.point, _pairs(found, model))
    where: dict[str, list[list[int]]] = {}
    at = 0
    for c in found:
        where[c.id] = c.columns(at)
        at += len(c.pairs(model))
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
        result = Scan((), empty, empty, empty, empty, refused)
        return Found(result, kept, linear, likelihood, {}, {}, space.driven)
    scored = score(likelihood, hypotheses, owners, rng, LEVEL / len(kept))
    p_value = _by_the_clock(space, linear, kept, where, scored, rng)
    result = Scan(
        tuple(c.id for c in kept),
        scored.ratio,
        np.minimum(p_value * len(kept), 1.0),
        scored.ratio - 2.0 * scored.null_median,
        scored.null_median,
        refused,
    )
    forms = [form for c in kept for form in c.variants]
    chosen = {
        c.id: (hypotheses[scored.chosen[i]], forms[scored.chosen[i]]) for i, c in enumerate(kept)
    }
    every = {c.id: list(zip(where[c.id], c.variants, strict=True)) for c in kept}
    return Found(result, kept, linear, likelihood, chosen, every, space.driven)


def _by_the_clock(
    space: Space, linear: Linear, kept: Sequence[Candidate], where: dict[str, list[list[int]]],
    scored: Scored, rng: np.random.Generator,
) -> FloatArray:
    """Chances (c,), of what is locked to the clock by what a base that goes by the drive may be
    wrong by: nothing else is a rival of it, and as long as much is amiss that has one scale with
    the dictionary's own trends, any of which does as well.
    """
    p_value = scored.p_value.copy()
    mine = [i for i, c in enumerate(kept) if CAUSES[c.id].locked_to == CLOCK]
    mine = [i for i in mine if p_value[i] * len(kept) > LATER]
    if not mine or linear.unknown is not None:
        return p_value
    driven = Likelihood(reduce(replace(linear, unknown=space.driven, axes={})))
    if driven.summit()[1] == 0:
        return p_value
    forms = [h for i in mine for h in where[kept[i].id]]
    owners = [n for n, i in enumerate(mine) for _ in where[kept[i].id]]
    p_value[mine] = score(driven, forms, owners, rng.spawn(1)[0], LEVEL / len(kept)).p_value
    return p_value


def _pairs(found: Sequence[Candidate], model: Model) -> list[tuple[Model, Model]]:
    return [pair for c in found for pair in c.pairs(model)]


def _playable(
    space: Space, found: Sequence[Candidate], model: Model
) -> tuple[list[Candidate], list[str]]:
    """Candidates with the forms that can be played with a model, and which have none."""
    kept, lost = [], []
    for c in found:
        forms = tuple(
            form for form in c.variants
            if all(playable(space, model.with_stage(t)) for t in form)
        )
        if forms:
            kept.append(Candidate(c.id, forms))
        else:
            lost.append(c.id)
    return kept, lost


def score_powers(
    linear: Linear, rng: np.random.Generator, least: float = 0.0
) -> tuple[float, float]:
    """Log-likelihood gained by a memoryless bend about a point, and its chance.

    A gain of no more than ``least`` is not asked for its chance, which is given as 1.
    """
    n, at = len(dictionary.POWERS), linear.layout.base
    reduced = reduce(linear, free=range(at, at + n))
    likelihood = Likelihood(replace(reduced, trials=reduced.trials[:, -n:]))
    if likelihood.evidence(range(-n, 0)) - likelihood.evidence() <= least:
        return least, 1.0
    scored = score(likelihood, [range(-n, 0)], [0], rng, LEVEL)
    return float(scored.ratio[0]), float(scored.p_value[0])


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
    kind = CAUSES[candidate.id]
    assert issubclass(kind, Cause)
    forms = kind.finer(trials)
    if kind.whole:  # of a share of it the largest may look likeliest, where a small one is
        forms = [*forms, *(list(f) for f in candidate.variants if _away(f) == _away(trials))]
    if forms:
        columns, likelihood, trials = _likeliest(space, fitted, forms, kind.whole)
    reduced = likelihood.reduced
    scales = likelihood.best_scales(columns)
    sigma = covariance_of(reduced, scales)
    t = reduced.trials[:, columns]
    solved = np.linalg.solve(sigma, np.column_stack([t, reduced.z]))
    gram = t.T @ solved[:, :-1]
    size = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram * np.outer(size, size) + 1e-6 * np.eye(len(columns))
    shares = size * np.linalg.solve(scaled, size * (t.T @ solved[:, -1]))
    stage = kind.begun(trials, shares)
    sizes = list(fitted.point.sizes)
    if kind.has_elements:
        sizes = [s for s in sizes if s[1] not in _beside_one_curve(s[0])]
    for name in stage.parameters:
        if name in kind.given:
            continue
        rest = kind.neutral.get(name, 0.0)
        moved = max(abs(t[name] - rest) for t in trials) / kind.sharp.get(name, 1.0)
        if name == kind.lasting:  # a long one is to be varied as finely as a short one
            moved = min(abs(t[name] - rest) for form in candidate.variants for t in form)
        if moved > 0:
            sizes.append((candidate.id, name, float(moved)))
    return Point(fitted.point.model.with_stage(stage), fitted.point.fixed, tuple(sizes))


def _beside_one_curve(id: str) -> tuple[str, ...]:
    kind = CAUSES.get(id)
    return kind.beside_one_curve if kind is not None and issubclass(kind, Cause) else ()


def _likeliest(
    space: Space, fitted: Fitted, forms: Sequence[Sequence[Stage]], whole: bool
) -> tuple[list[int], Likelihood, Sequence[Stage]]:
    """The form, of as many examples each, that says most in a linear look.

    ``whole`` : each as it is, and not any share of it
    """
    model, n = fitted.point.model, len(forms[0])
    pairs = [(model, model.with_stage(t)) for form in forms for t in form]
    likelihood = Likelihood(reduce(space.linear(fitted.point, pairs)))
    sets = [list(range(k * n, (k + 1) * n)) for k in range(len(forms))]
    if whole:
        worth = likelihood.evidence_less_each()
    else:
        worth = [likelihood.evidence(columns) for columns in sets]
    best = int(np.argmax(worth))
    return sets[best], likelihood, forms[best]
