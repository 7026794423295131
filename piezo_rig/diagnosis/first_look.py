"""A first look at some of the drives of a long session.

A matrix has dozens of drives. What is large shows in a third of them as well as in all, and a
search there takes a third of the time. Only what is beyond any doubt is taken from there; it is
fitted to all drives, and the search goes on with all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezo_rig.diagnosis.climb import Search, Tell
from piezo_rig.diagnosis.detours import around
from piezo_rig.diagnosis.forms import converged
from piezo_rig.diagnosis.groups import Group, Groups
from piezo_rig.diagnosis.ladder import Ladder, Step
from piezo_rig.diagnosis.reaches import Known, at_their_reaches
from piezo_rig.diagnosis.refit import Fitted, refit
from piezo_rig.diagnosis.space import Space
from piezo_rig.diagnosis.spare import clear

FloatArray = NDArray[np.float64]
BEYOND_DOUBT = 1e-9  # chance of a false alarm of what is taken along
MANY, EVERY = 15, 3  # drives from which on only each so many-th is looked at first
MUCH = 25_000  # samples, as they are thinned, below which all are looked at at once


def some_of(groups: Groups) -> Groups | None:
    """Every third drive, by the size of its loops, of those in the lower half of the range and of
    those in the upper, with the largest of each; None where there are few, or little of each.
    """
    if len(groups.groups) < MANY or sum(groups.edges(g)[-1][1] for g in groups.groups) < MUCH:
        return None
    middle_v = 0.5 * sum(groups.ends_v)
    upper = [g for g in groups.groups if np.mean(_turns_v(g)) > middle_v]
    lower = [g for g in groups.groups if g not in upper]
    chosen = {
        id(g)
        for same in (lower, upper)
        for g in sorted(same, key=lambda g: -float(np.median(_swings_v(g))))[::EVERY]
    }
    return groups.with_([g for g in groups.groups if id(g) in chosen])


def _turns_v(group: Group) -> FloatArray:
    """Where the drive turns, but for its first and last stretch; shape (k,)."""
    inner = group.loops.start[1:] if len(group.loops) > 2 else group.loops.start
    return group.drive_v[inner]


def _swings_v(group: Group) -> FloatArray:
    """How far each half loop goes, shape (k,)."""
    return np.abs(group.drive_v[group.loops.stop] - group.drive_v[group.loops.start])


def look(
    space: Space, first: Fitted, rng: np.random.Generator, tell: Tell,
    held_out: Sequence[tuple[Callable[[Fitted], float], float]], noise_nm: float, others: int,
    helps: Callable[[Fitted, Fitted], bool], brief: bool,
) -> Ladder:
    """What is beyond any doubt already by some of the drives; arguments as those of `climb`."""
    search = Search(
        space, first, rng, tell, held_out, noise_nm, others, helps, level=BEYOND_DOUBT
    )
    search.forward()
    if not brief:
        clear(search)
        around(search)
    return Ladder(search.first, tuple(search.steps), tuple(search.scans))


def on_all(
    space: Space, looked: Ladder, held_out: Callable[[Fitted], float], tell: Tell
) -> tuple[list[Step], dict[str, Known]]:
    """The steps of a look at some drives, the last one fitted to all; how far its laws reach.

    That is found before anything else is looked for.
    """
    if not looked.steps:
        return [], {}
    tell(f"{len(looked.steps)} causes with all drives")
    *before, last = looked.steps
    fitted = converged(space, refit(space, last.fitted.point, held=True))
    ladder = replace(looked, steps=(*before, replace(last, fitted=fitted)))
    ladder, known = at_their_reaches(space, ladder, held_out)
    return list(ladder.steps), known
