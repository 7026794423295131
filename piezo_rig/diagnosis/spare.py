"""What a ladder can spare: members that others have made needless, or that say nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.diagnosis.abreast import abreast
from piezo_rig.diagnosis.among_repeats import PLAINLY, told
from piezo_rig.diagnosis.confusion import APART, certainties, strengths
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.held_out import without_first_rises
from piezo_rig.diagnosis.ladder import Ladder, Step
from piezo_rig.diagnosis.needed import needless, plain_bend, worth_needed
from piezo_rig.diagnosis.refit import Fitted, refit, settle, wholly
from piezo_rig.diagnosis.refusals import CAME_TO_NOTHING, like_no_other, of_a_law
from piezo_rig.diagnosis.scan import of_base
from piezo_rig.diagnosis.space import Space
from piezo_rig.diagnosis.unexplained import unexplained
from piezo_rig.diagnosis.warmth import of_warmth, still_warm

if TYPE_CHECKING:
    from piezo_rig.diagnosis.climb import Search

NEEDED = 3.0  # log-likelihood that decides between models
SAFE = 20.0  # times what a table must be worth: not looked at again
# d' of a member beside others, and of a table of its own: a true effect of 40 keeps 16 and more,
# what the base model of a bench of somebody else's gets wrong goes by such names with 7 to 10
BESIDE, OF_A_TABLE = 10.0, 12.0
UNSEEN = 20.0  # the same of a table, where what is held out has no first rise to predict
OF_A_BEND = 5.0  # which is no name, but without which others stand in for it
AMISS = 0.45  # of the noise: what is left beside it where something is amiss
HARDLY = 1.0  # held-out error with a member, of that before
LOSES = 1.001  # the same of the whole ladder, of that without the member
FAR_WORSE = 1.2  # the same, from which on a bend is not kept, however plain it is
NEXT_TO_NOTHING = 0.05  # log-likelihood of what is left with a member, of that without it
MORE = 0.1  # of the squared noise, of what is held out and left without a member
PLAIN = 50.0  # log-likelihood of a member that is dropped only if it does harm beyond doubt
OF_WHAT_IT_TOOK = 0.5  # squared error: a table that leaves more only stands in for something
MOST = 0.5  # squared error beside the noise that a member leaves, of that without it
OF_THE_REST = 0.25  # squared error beside the noise, of what a table took off, that is little
AGAIN = 3  # times that what was refused beside something faint is tried
WEAK, SHADOW = 16.0, 15.0  # d' and log-likelihood that leave an effect in doubt beside such laws


def one_by_one(space: Space, steps: Sequence[Step], tell: Callable[[str], None]) -> list[Step]:
    """Steps whose members have changed, each fitted with those before it.

    One that was fitted beside the same members is kept.
    """
    last = steps[-1]
    point, points = last.fitted.point, [last.fitted.point]
    for step in steps[:0:-1]:
        point = point.without(step.cause)
        points.insert(0, point)
    anew = [
        k for k, (s, p) in enumerate(zip(steps[:-1], points, strict=False))
        if s.fitted.space is not space or set(s.fitted.point.names) != set(p.names)
        or not _same_stages(s.fitted.point, p)
    ]  # fmt: skip
    if anew:
        tell(f"refit up to {', '.join(steps[k].cause for k in anew)}, one by one")
    fits = abreast(space, [partial(refit, space, points[k]) for k in anew], last.fitted.parts)
    found = dict(zip(anew, fits, strict=True))
    return [replace(s, fitted=found.get(k, s.fitted)) for k, s in enumerate(steps)]


def _same_stages(a: Point, b: Point) -> bool:
    return {s.id for s in a.model.stages} == {s.id for s in b.model.stages}


def faded(space: Space, ladder: Ladder, tell: Callable[[str], None]) -> Ladder:
    """Without members that cannot be told from nothing any more, now that laws have moved."""
    steps, plain = list(ladder.steps), set[str]()
    while any(s.cause in CAUSES and s.cause not in plain for s in steps):
        last = steps[-1].fitted
        settle(space, last.point)
        members = [s.cause for s in steps if s.cause in CAUSES]
        found = certainties(space, last, members)
        id = min((c for c in members if c not in plain), key=lambda c: found[c])
        if found[id] >= APART:
            break
        tell(f"refit without {id}")
        less = refit(space, last.point.without(id), held=True)
        if plain_bend(id, last, less):
            plain.add(id)
            continue
        steps = [s for s in steps if s.cause != id]
        if steps:
            steps[-1] = replace(steps[-1], fitted=less)
    if len(steps) == len(ladder.steps):
        return ladder
    return replace(ladder, steps=tuple(one_by_one(space, steps, tell) if steps else ()))


def _less_what_is_warmth(search: Search) -> None:
    """Drop earlier members that were taken in for what warmth says better beside the newest one."""
    new = search.steps[-1]
    if not still_warm(search.space, new.fitted):
        return
    for id in search.causes[:-1]:
        if CAUSES[id].has_elements or of_base(id):
            continue
        search.tell(f"refit without {id}")
        less = refit(search.space, new.fitted.point.without(id), held=True)
        if of_warmth(search.space, less, new.fitted, id) is not None:
            search.drop(id, new, less)
            new = search.steps[-1]


def prune(search: Search) -> None:
    """Drop an earlier member that the newest one has made needless."""
    new = search.steps[-1]
    for id in search.causes[:-1]:
        if CAUSES[id].has_elements and id not in search.safe:
            search.tell(f"refit without {id}")
            less = refit(search.space, new.fitted.point.without(id), held=True)
            needed = worth_needed(new.fitted, id)
            if less.evidence < new.fitted.evidence - SAFE * needed:
                search.safe.add(id)
            if less.evidence > new.fitted.evidence - needed:
                search.drop(id, new, less)
                new = search.steps[-1]
    for id in search.causes[:-1]:
        if of_a_law(search, new.fitted, id) is None:
            continue
        search.tell(f"refit without {id}")
        less = refit(search.space, new.fitted.point.without(id), held=True)
        if of_a_law(search, new.fitted, id, less) is not None:
            search.drop(id, new, less)
            new = search.steps[-1]
    _less_what_is_warmth(search)
    _one_thing_less(search)
    new = search.steps[-1]
    spare = needless(new.fitted, [c for c in search.causes if c != new.cause])
    if spare is None:
        return
    search.tell(f"refit without {spare}")
    less = refit(search.space, new.fitted.point.without(spare))
    if less.evidence >= new.fitted.evidence - NEEDED:
        search.drop(spare, new, less)


def _one_thing_less(search: Search) -> None:
    """Without what a member was given to do besides, where that has become needless."""
    for id in search.causes:
        stage = search.fitted.point.model.stage(id)
        if not isinstance(stage, Cause):
            continue
        for form in stage.less():
            search.tell(f"refit with less of {id}")
            before = search.fitted
            gone = {n for n in stage.parameters if form[n] != stage[n]}
            sizes = tuple(s for s in before.point.sizes if s[0] != id or s[1] not in gone)
            point = Point(before.point.model.with_stage(form), before.point.fixed, sizes)
            less = refit(search.space, point, held=True)
            if less.evidence > before.evidence - NEEDED:
                search.steps[-1] = replace(search.steps[-1], fitted=less)
                search.rearranged = True
                break


def less_what_is_faint(search: Search) -> None:
    """Drop what is faint, which may have stood where something else belongs.

    What was refused beside it is tried again.
    """
    gone = set[str]()
    for _ in range(AGAIN):
        members = search.causes
        faint(search)
        if search.causes == members or not search.left_over():
            return
        gone |= set(members) - set(search.causes)
        search.barred = {
            id: why for id, why in search.barred.items() if id in gone or why == CAME_TO_NOTHING
        }
        search.forward()
    faint(search)


def faint(search: Search) -> None:
    """Drop what cannot be told from nothing once everything else is allowed for."""
    plain = set[str]()
    while any(c not in plain for c in search.causes):
        settle(search.space, search.fitted.point)
        found = certainties(search.space, search.fitted, search.causes)
        needed = {c: _certain(c, len(found) == 1) for c in found}
        id = min((c for c in search.causes if c not in plain), key=lambda c: found[c] / needed[c])
        if found[id] >= needed[id]:
            return
        search.tell(f"refit without {id}")
        less = refit(search.space, search.fitted.point.without(id), held=True)
        if plain_bend(id, search.fitted, less) or (
            found[id] >= APART and (_explains_the_rest(search, less) or _told(search, less))
        ):
            plain.add(id)
            continue
        rest = [s for s in search.steps if s.cause != id]
        if rest:
            search.drop(id, rest[-1], less)
        else:
            search.steps, search.barred[id] = [], "cannot be told from nothing"


def _explains_the_rest(search: Search, less: Fitted) -> bool:
    """Whether something is left without a member, and next to nothing of it with it.

    What a base model gets wrong goes by many names, and none of them leaves nothing of it. Nor
    does any of them foretell nearly all of what was held out beside the noise: a drift that a few
    cycles hardly show is most of what is wrong some cycles later.
    """
    if not search.helps(less, search.fitted):
        return False
    noise = search.noise_nm**2
    unseen, left = (search.error(0, f) ** 2 - noise for f in (less, search.fitted))
    if unseen > MORE * noise and left <= NEXT_TO_NOTHING * unseen:
        return True
    without = search.left_over(less)
    return without > 0.0 and search.left_over() <= NEXT_TO_NOTHING * without


def _told(search: Search, less: Fitted) -> bool:
    """Whether what recordings of one drive differ by says that a member is there."""
    return told(search.space, search.fitted.point.model, less.point.model) >= PLAINLY


def _certain(id: str, alone: bool) -> float:
    """What d' it must have, with everything else allowed for."""
    if CAUSES[id].has_elements:
        return OF_A_TABLE
    if alone:
        return APART
    return OF_A_BEND if of_base(id) else BESIDE


def idle(search: Search) -> bool:
    """Drop what does not help to predict, while something that nobody has a name for is left.

    Whether anything was dropped: it may have stood where something else belongs.

    The evidence of a small cause takes what is left for noise. What is left of an unknown effect
    is not: any cause that bends that way gains by it, and none of them says what the next
    recording will be; it must be as plain as beside other causes. Nor is what the assumed law of
    another member leaves: a table of its own beside others must help in any case, for it bends any
    way, and not leave as much as it takes.
    Nor is it for any of them to make the next recording worse to predict. (That it is hardly better
    says little: a small fast effect is far below the error of a sample, and what else is amiss may
    make it worse by as little; a plain one must do harm beyond doubt, unless it is a table.) More
    than that is not asked of what belongs to the base: without it others would stand in for it.
    """
    dropped = False
    while search.causes:
        left_over = search.left_over() > 0.0
        unknown = _unknown_nm(search) if left_over else 0.0
        tables = [c for c in search.causes if CAUSES[c].has_elements]
        doubted = tables if len(search.causes) > 1 or far_off(search) else []
        if tables and without_first_rises(search.space):
            found = certainties(search.space, search.fitted, tables)
            doubted = [c for c in doubted if found[c] < UNSEEN]
        tried = search.causes if unknown else {*doubted, *_gained_nothing(search)}
        sure = certainties(search.space, search.fitted, search.causes) if unknown else {}
        for id in reversed([c for c in search.causes if c in tried]):
            search.tell(f"refit without {id}")
            less = refit(search.space, search.fitted.point.without(id), held=True)
            if (unknown and not of_base(id)) or id in doubted:
                kept = search.helps(less, search.fitted) and sure.get(id, BESIDE) >= BESIDE
                kept = kept or like_no_other(search.fitted, less)
                kept = kept or (id in tables and not unknown and _takes_the_rest(search, less, id))
                kept = kept or _takes_most(search, less)
                kept = kept and not (id in tables and _stands_in(search, less, unknown, left_over))
            else:
                ratio = search.error(0, search.fitted) / max(search.error(0, less), 1e-12)
                kept = ratio <= LOSES
                kept = kept or (ratio < FAR_WORSE and plain_bend(id, search.fitted, less))
                kept = kept or like_no_other(search.fitted, less)
                kept = kept or _plain(search, less, id if id in tables else "")
            if kept:
                continue
            rest = [s for s in search.steps if s.cause != id]
            if rest:
                search.drop(id, rest[-1], less)
            else:
                search.steps = []
            beside = "what nothing explains" if unknown else "what is found"
            search.barred[id] = f"does not help to predict, beside {beside}"
            dropped = True
            break
        else:
            break
    return dropped


def _plain(search: Search, less: Fitted, table: str = "") -> bool:
    """Whether a model says far more than one without a member, and predicts no worse for sure.

    ``table`` : the member, where it is one; it bends any way, as what shook a recording does
    """
    if table and not _takes_the_rest(search, less, table):
        return False
    plainly = search.fitted.evidence > less.evidence + PLAIN
    return plainly and not search.helps(search.fitted, less, False)


def _gained_nothing(search: Search) -> list[str]:
    """Members with which the ladder predicted no better than before."""
    fits = [search.first, *(s.fitted for s in search.steps)]
    return [
        step.cause for step, before in zip(search.steps, fits, strict=False)
        if step.cause in CAUSES
        and search.error(0, step.fitted) > HARDLY * search.error(0, before)
    ]  # fmt: skip


def _left(search: Search) -> float:
    """Square of what is left beside the noise, nm^2."""
    return max(search.error(0, search.fitted) ** 2 - search.noise_nm**2, 0.0)


def far_off(search: Search) -> bool:
    """Whether more is left than a fit to few recordings leaves."""
    return _left(search) > (AMISS * search.noise_nm) ** 2


def _stands_in(search: Search, less: Fitted, unknown_nm: float, left_over: bool) -> bool:
    """Whether a table takes off little more than it leaves.

    A first rise of its own that is there leaves nothing. One that bends towards what a law, or
    something that nobody has a name for, does to first rises leaves what they do elsewhere.

    ``left_over`` : whether anything is left that is not noise; a model of few recordings follows
    slow noise, and predicts another one the worse for it
    """
    took = search.error(0, less) ** 2 - search.error(0, search.fitted) ** 2
    left = max(_left(search) if left_over and far_off(search) else 0.0, unknown_nm**2)
    return left > OF_WHAT_IT_TOOK * took


def _takes_most(search: Search, less: Fitted) -> bool:
    """Whether a plain member takes off most of what was held out beside the noise.

    Of two recordings an interval of what it gains may be as wide as that is large.
    """
    noise = search.noise_nm**2
    without, left = (max(search.error(0, f) ** 2 - noise, 0.0) for f in (less, search.fitted))
    return left < MOST * without and search.fitted.evidence > less.evidence + PLAIN


def _takes_the_rest(search: Search, less: Fitted, id: str) -> bool:
    """Whether a plain table takes off nearly all that was held out beside the noise.

    A first rise happens once. Of few recordings the stretches that are compared have nothing of it
    but for the first ones, and whatever it gains there they cannot be sure of.
    """
    took = search.error(0, less) ** 2 - search.error(0, search.fitted) ** 2
    if took <= 0.0 or _left(search) > OF_THE_REST * took:
        return False
    return certainties(search.space, search.fitted, [id])[id] >= UNSEEN


def _unknown_nm(search: Search) -> float:
    """What is left, where that is more than what the laws of the members may leave."""
    square, before = 0.0, search.error(0, search.first)
    for step in search.steps:
        after = search.error(0, step.fitted)
        if step.cause in CAUSES and not (CAUSES[step.cause].has_elements or of_base(step.cause)):
            square += max(before**2 - after**2, 0.0)
        before = after
    by_laws_nm = float(np.sqrt(square))
    found = unexplained(
        search.space, search.fitted, search.noise_nm, by_laws_nm, search.rng, before
    )
    return found.rms_nm if found.detected else 0.0


def clear(search: Search) -> None:
    """Drop what is hardly needed beside large effects whose laws are only assumed."""
    if len(search.causes) < 2:
        return
    settle(search.space, search.fitted.point)
    members = [c for c in search.causes if not CAUSES[c].has_elements]
    found = strengths(search.space, search.fitted, members)
    for id in sorted(members, key=lambda c: found[c]):
        kinds = [CAUSES[c] for c in search.causes if c != id and found.get(c, 0.0) > found[id]]
        if found[id] > WEAK or not any(issubclass(k, Cause) and k.law for k in kinds):
            continue
        search.tell(f"refit without {id}")
        less = refit(search.space, search.fitted.point.without(id), held=True)
        if less.evidence > search.fitted.evidence - SHADOW:
            new = next(s for s in reversed(search.steps) if s.cause != id)
            search.drop(id, new, less)


def stood_in(search: Search, id: str) -> None:
    """Drop what only stood in for what the law of a member could not do."""
    for other in search.causes:
        if other == id or CAUSES[other].has_elements:
            continue
        search.tell(f"refit without {other}")
        less = wholly(search.space, search.fitted.point.without(other))
        if less.evidence > search.fitted.evidence - SHADOW:
            new = next(s for s in reversed(search.steps) if s.cause != other)
            search.drop(other, new, less)
