"""Other ways up: around a member that others could stand in for, and two causes at once."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from piezo_rig.causes import CAUSES
from piezo_rig.diagnosis.abreast import abreast
from piezo_rig.diagnosis.confusion import strengths
from piezo_rig.diagnosis.forms import CARRIES, carries, converged, summit
from piezo_rig.diagnosis.ladder import Step
from piezo_rig.diagnosis.needed import worth_needed
from piezo_rig.diagnosis.own_laws import also
from piezo_rig.diagnosis.refit import Fitted, refit, settle
from piezo_rig.diagnosis.refusals import CAME_TO_NOTHING, SAYS_NO_MORE, worse
from piezo_rig.diagnosis.scan import LATER, FloatArray, Scan, by_speed, has_reach, of_base, scan
from piezo_rig.diagnosis.space import CLOCK
from piezo_rig.diagnosis.spare import NEEDED, far_off

if TYPE_CHECKING:
    from piezo_rig.diagnosis.climb import Search

ABREAST = 2  # members that are left out at a time
ONE_MORE = 20.0  # log-likelihood of a member at `LATER`: no detour has it for less
ROUNDS = 2  # of detours
DETOURS = 2  # at most, from one ladder
FAR_LESS, PLAIN = 0.7, 100.0  # held-out error with two causes, of that with neither; worth of both
FORETELLS = 0.99  # held-out error with another member, that makes up for so much evidence
RIVAL = 0.4  # score of a rival, of the member's own


def rivals_of(found: Scan, member: str, chances: FloatArray) -> list[str]:
    """Causes that come near a member, where it is left out; look-alikes if they say anything."""
    own = RIVAL * float(found.excess[found.ids.index(member)])
    return [
        id for id, excess, p in zip(found.ids, found.excess, chances, strict=True)
        if id != member
        and (excess >= own or (p < LATER and by_speed(id) and by_speed(member)))
    ]


def around(search: Search) -> None:
    """Detours, as long as they lead somewhere and something asks for them."""
    for _ in range(ROUNDS):
        if search.patience.lost or not (search.few or search.left_over()) or not detour(search):
            break


def detour(search: Search) -> bool:
    """Climb once more without a member; True where that led somewhere better.

    One cause may stand in for two others, neither of which improves on it alone. Members that
    are worth least are tried first, and only where a rival comes near them. What needs more than
    one more member than the ladder at hand is no better explanation. A member that is alone is
    doubted only where something is left beside it, or where another law of the first spring came
    near it: their forms are many, and those that were compared need not be the best of each.
    """
    if not search.causes:
        return False
    alone = len(search.causes) == 1
    if alone and not (far_off(search) or any(s.doubted for s in search.steps)):
        return False
    full, taken = search.fitted, 0
    for member, less, found in _one_by_one(search):
        if taken == DETOURS:
            break
        if member not in found.ids:
            continue
        if not rivals_of(found, member, search.family(found)):
            continue
        taken += 1
        search.tell(f"detour around {member}")
        bends = {id: why for id, why in search.barred.items()
                 if of_base(id) and id in search.refused_at
                 and why in (SAYS_NO_MORE, CAME_TO_NOTHING)}  # fmt: skip
        other = replace(
            search,
            steps=[replace(s, fitted=less) for s in search.steps if s.cause != member],
            scans=[], barred={member: "without it a better model was found"} | bends,
            refused_at={id: search.refused_at[id] for id in bends}, spoiled={}, rearranged=True,
            aside=True, most=min(search.most, len(search.causes) + 1),
            goal=_worth(search) - NEEDED,
        )  # fmt: skip
        other.forward()
        if alone:
            _at_its_best(other)
        more = len(other.causes) - len(search.causes)
        better = NEEDED + ONE_MORE * more if more >= 0 else -NEEDED  # than with one to spare
        before = search.steps
        if _worth(other) < _worth(search) + better:
            search.steps = with_stand_in(search, before, other.steps, other.fitted)
            continue
        if worse(other, other.fitted, full) is not None:
            continue
        search.steps, search.barred, search.rearranged = other.steps, other.barred, True
        search.steps = with_stand_in(search, other.steps, before, full)
        search.scans += other.scans
        if len(other.causes) >= other.most:  # it was not to go on
            search.forward()
        return True
    return False


def _at_its_best(search: Search) -> None:
    """The only member of a ladder with all that it may do, at its own reach: what it is compared
    with has gone through that.
    """
    if len(search.causes) != 1 or not has_reach(search.causes[0]):
        return
    member = search.causes[0]  # a bend may have been taken in after it
    for _ in range(2):
        step = search.steps[-1]
        fitted = summit(search.space, converged(search.space, step.fitted), member)
        search.steps[-1] = replace(step, fitted=fitted)
        if not also(search, search.fitted, 0.0):
            break


def with_stand_in(
    search: Search, steps: list[Step], others: Sequence[Step], fitted: Fitted
) -> list[Step]:
    """Steps, of which one has another's only other member for a rival, if with that one the model
    is as good.

    ``fitted`` : by those others
    """
    own, theirs = (
        {s.cause for s in some if s.cause in CAUSES and not of_base(s.cause)}
        for some in (steps, others)
    )
    mine, rivals = own - theirs, theirs - own
    if len(mine) != 1 or len(rivals) != 1:
        return steps
    (member,), (rival,) = mine, rivals
    here = steps[-1].fitted
    short = _beyond(here, own) - _beyond(fitted, theirs)
    better = search.error(0, fitted) < FORETELLS * search.error(0, here) and short < ONE_MORE
    if not (better or search.as_good(fitted, here, rival, short)):
        return steps
    return [
        replace(s, rivals={**s.rivals, rival: -short}) if s.cause == member else s for s in steps
    ]


def _worth(search: Search) -> float:
    """Evidence of a ladder beyond what its tables gain by chance, and laws that hang on two half
    loops: see `race.tried`.
    """
    return _beyond(search.fitted, search.causes)


def _beyond(fitted: Fitted, members: Collection[str]) -> float:
    """The same of a model with these members."""
    return fitted.evidence - sum(
        worth_needed(fitted, s.id) + CARRIES * carries(fitted, s.id)
        for s in fitted.point.model.stages if s.id in members
    )


def _one_by_one(search: Search) -> Iterator[tuple[str, Fitted, Scan]]:
    """Every member left out, about the one that is worth least first; by two at a time."""
    full, space = search.fitted, search.space
    tables = [c for c in search.causes if CAUSES[c].has_elements]
    others = [c for c in search.causes if c not in tables]
    settle(space, full.point)
    worth = strengths(space, full, others) if others else {}
    order = [*tables, *sorted(others, key=lambda c: worth[c])]
    streams = search.rng.spawn(len(order))
    for k in range(0, len(order), ABREAST):
        members = order[k : k + ABREAST]
        search.tell(f"refit without {' or '.join(members)}")
        made = abreast(space, [
            partial(_without, search, member, rng)
            for member, rng in zip(members, streams[k:], strict=False)
        ], full.parts)  # fmt: skip
        both = sorted(zip(members, made, strict=True), key=lambda m: -m[1][0].evidence)
        for member, (less, found) in both:
            yield member, less, found


def _without(search: Search, member: str, rng: np.random.Generator) -> tuple[Fitted, Scan]:
    """Refitted without a member, and what fits then."""
    less = refit(search.space, search.fitted.point.without(member), held=True)
    settle(search.space, less.point)
    return less, scan(search.space, less, rng, {}).result


def together(search: Search, here: Fitted) -> bool:
    """Take two causes at once, each of which spoils the other's fit, if nothing is then left, or
    they explain much of it.

    The likeliest that was refused for its held-out error, or that alone says nothing, is put in,
    and what then fits best; failing that, the likeliest of those that go by the clock: with a law
    of turning points in its place nothing is left for a drift, and beside it the law is plain.
    """
    if search.aside or not search.spoiled:
        return False
    spoiled = sorted(search.spoiled.values(), key=lambda s: -s.fitted.evidence)
    drifts = [s for s in spoiled[1:] if CAUSES[s.cause].locked_to == CLOCK]
    search.spoiled = {}
    return any(beside(search, here, first) for first in (spoiled[0], *drifts[:1]))


def beside(search: Search, here: Fitted, first: Step) -> bool:
    """Take one that was refused and what then fits best."""
    search.tell(f"with {first.cause} and one more")
    other = replace(
        search, steps=[*search.steps, first], scans=[], barred={}, refused_at={}, spoiled={}
    )
    settle(search.space, first.fitted.point)
    found = scan(search.space, first.fitted, search.rng)
    family = search.family(found.result)
    good = np.flatnonzero(family < LATER)
    if not good.size or not other.take(first.fitted, found, good, family):
        return False
    more = len(other.causes) - len(search.causes)  # either may have been a way to the other only
    if more not in (1, 2) or worse(other, other.fitted, here) is not None:
        return False
    if _worth(other) < _worth(search) + NEEDED + ONE_MORE:
        return False
    if other.left_over() and not _much(search, here, other):
        return False
    search.steps, search.barred, search.rearranged = other.steps, other.barred, other.rearranged
    return True


def _much(search: Search, here: Fitted, other: Search) -> bool:
    """Whether two causes explain much of what is amiss, though not all of it."""
    if search.error(0, other.fitted) < FAR_LESS * search.error(0, here):
        return True
    return _worth(other) > _worth(search) + PLAIN and search.helps(here, other.fitted, False)
