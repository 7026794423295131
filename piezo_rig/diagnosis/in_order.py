"""The order of a ladder's rungs: each is to take something away from the error, and what belongs to
the base comes before any cause.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from piezo_rig.diagnosis.found import NO_FINDINGS
from piezo_rig.diagnosis.ladder import Ladder
from piezo_rig.diagnosis.refit import Fitted, refit
from piezo_rig.diagnosis.space import Space
from piezo_rig.diagnosis.spare import one_by_one

RAISES = 1.005  # held-out error of a rung, of that of the one before


def bends_first(
    space: Space, ladder: Ladder, error_nm: Callable[[Fitted], float], tell: Callable[[str], None]
) -> Ladder:
    """The ladder with the bends of the base model before all causes, unless alone they predict
    worse than nothing.

    What a cause gains is measured against the model before it. Where a bend is missing from that,
    what the bend hides is not gained, and a true cause seems to do little, or harm.
    """
    bends = [s for s in ladder.steps if s.cause in NO_FINDINGS]
    ordered = [*bends, *(s for s in ladder.steps if s.cause not in NO_FINDINGS)]
    if [s.cause for s in ordered] == [s.cause for s in ladder.steps]:
        return ladder
    ordered[-1] = replace(ordered[-1], fitted=ladder.last)
    ordered = one_by_one(space, ordered, tell)
    if error_nm(ordered[len(bends) - 1].fitted) > RAISES * error_nm(ladder.first):
        return ladder
    return replace(ladder, steps=tuple(ordered))


def in_order(
    space: Space, ladder: Ladder, error_nm: Callable[[Fitted], float],
    tell: Callable[[str], None],
) -> Ladder:
    """The ladder with a rung that raises the error behind the next, if that one lowers it alone.

    A cause that was taken in for what it explains may predict nothing until another is there that
    was accepted later; beside it, and after it, it does.
    """
    steps = list(ladder.steps)
    for _ in range(len(steps)):
        errors = [error_nm(ladder.first), *(error_nm(s.fitted) for s in steps)]
        raising = (k for k in range(len(steps) - 1) if errors[k + 1] > RAISES * errors[k])
        k = next(raising, None)
        if k is None:
            break
        here, after = steps[k], steps[k + 1]
        tell(f"{after.cause} before {here.cause}")
        sooner = refit(space, after.fitted.point.without(here.cause), held=True)
        if error_nm(sooner) >= errors[k]:
            break
        steps[k : k + 2] = [replace(after, fitted=sooner), replace(here, fitted=after.fitted)]
    return replace(ladder, steps=tuple(steps))
