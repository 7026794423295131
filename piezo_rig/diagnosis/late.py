"""A delay for a lag, and a lag for a delay, once more is known.

Which of the two there is shows at corners alone. A linear look names one of them while something
is still missing that corners show as well. So the other is put in its place whenever a member has
been found beside it, and stays where it says plainly more; at the end it is an alternative where
it says as much.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.forms import as_late, converged
from piezo_rig.diagnosis.needed import too_long
from piezo_rig.diagnosis.refit import STEPS, Fitted, refit
from piezo_rig.diagnosis.refusals import worse
from piezo_rig.diagnosis.scan import by_speed, candidates
from piezo_rig.diagnosis.spare import far_off
from piezo_rig.errors import InputError

if TYPE_CHECKING:
    from piezo_rig.diagnosis.climb import Search

PLAINLY = 3.0  # log-likelihood by which the other must say more
EACH = 20.0  # and for each member more
HALF = 0.5  # squared error beyond the noise, of that before, which is as good
# where a lag and a delay together are begun: times how late one thing alone is, share of the lag
TOTALS, SHARES = (1.0, 1.5, 2.0, 3.0, 4.0), (0.25, 0.5, 0.75)
LIKELIEST = 3  # of those that are refitted

def rather_the_other(search: Search) -> None:
    """Put a delay in a lag's place, or a lag in a delay's, where that says plainly more."""
    for k, id, there in _the_others(search):
        if there.evidence < search.fitted.evidence + PLAINLY:
            continue
        if worse(search, there, search.fitted) is not None:
            continue
        steps = [*search.steps]
        steps[k] = replace(steps[k], cause=id, rivals={})
        steps[-1] = replace(steps[-1], fitted=there)
        search.steps, search.rearranged = steps, True
        search.barred.pop(id, None)
        return


def both(search: Search) -> bool:
    """Put a lag and a delay where one thing that goes by speed leaves much; whether they stay.

    Of a large lag and a large delay neither alone looks like much: what the other does to corners
    is then in the way.
    """
    groups, model = search.space.groups, search.fitted.point.model
    late: dict[str, float] = {}
    for id in search.causes:
        stage = model.stage(id)
        if by_speed(id) and isinstance(stage, Cause):
            late[id] = stage.late_s(groups.travel_um / groups.span_v)
    kinds = [k for k in CAUSES.values() if issubclass(k, Cause) and k.lasting]
    if not late or not np.isfinite(list(late.values())).all() or not far_off(search):
        return False
    if all(k.id in late for k in kinds) or any(k.id in search.space.excluded for k in kinds):
        return False
    less, most = search.fitted.point, max(late.values())
    for id in late:
        less = less.without(id)
    search.tell(f"refit with {' and '.join(k.id for k in kinds)} for {', '.join(late)}")

    def begun(total: float, share: float) -> Point:
        point = less
        for kind, part in zip(kinds, (share, 1.0 - share), strict=True):
            own = kind.of(None, **{kind.lasting: part * total})
            sizes = (*point.sizes, (kind.id, kind.lasting, 0.1 * part * total))
            point = replace(point, model=point.model.with_stage(own), sizes=sizes)
        return point

    begins = [begun(times * most, share) for times in TOTALS for share in SHARES]
    looked = [f for p in begins if (f := _refitted(search, p, 0)) is not None]
    likeliest = sorted(looked, key=lambda f: -f.evidence)[:LIKELIEST]
    ends = [f for one in likeliest if (f := _refitted(search, one.point)) is not None]
    if not ends:
        return False
    there = converged(search.space, max(ends, key=lambda f: f.evidence))
    if any(too_long(search.space, there.point, k.id) for k in kinds):
        return False
    needed = PLAINLY + EACH * (len(kinds) - len(late))
    if there.evidence < search.fitted.evidence + needed and not _foretells(search, there):
        return False
    if worse(search, there, search.fitted) is not None:
        return False
    first = next(s for s in search.steps if s.cause in late)
    rest = [s for s in search.steps if s.cause not in late]
    search.steps = [*rest, *(replace(first, cause=k.id, fitted=there, rivals={}) for k in kinds)]
    for kind in kinds:
        search.barred.pop(kind.id, None)
    search.rearranged = True
    return True


def _refitted(search: Search, point: Point, steps: int = STEPS) -> Fitted | None:
    """A point refitted; None where it cannot be played."""
    try:
        return refit(search.space, point, steps, held=True)
    except (InputError, np.linalg.LinAlgError):
        return None


def _foretells(search: Search, there: Fitted) -> bool:
    """Whether half of what a ladder leaves of what was held out is gone, beyond doubt."""
    noise = search.noise_nm**2
    left, before = (search.error(0, f) ** 2 - noise for f in (there, search.fitted))
    return left < HALF * before and search.helps(search.fitted, there, False)


def note_the_other(search: Search) -> None:
    """Note a lag or a delay that may as well stand in the place of the other."""
    for k, id, there in _the_others(search):
        step = search.steps[k]
        if id not in step.rivals and search.as_good(there, search.fitted, id):
            gained = there.evidence - search.fitted.evidence
            search.steps[k] = replace(step, rivals={**step.rivals, id: gained})


def _the_others(search: Search) -> Iterator[tuple[int, str, Fitted]]:
    """Steps by number, what may stand in the place of each, and the refit with that."""
    members = search.causes
    for k, step in enumerate(search.steps):
        own = CAUSES.get(step.cause)
        if own is None or not (issubclass(own, Cause) and own.lasting):
            continue
        offered, _ = candidates(search.space, search.fitted.point.model.without(step.cause))
        for c in offered:
            kind = CAUSES[c.id]
            assert issubclass(kind, Cause)
            if not kind.lasting or c.id in members:
                continue
            search.tell(f"refit with {c.id} for {step.cause}")
            there = _instead(search, own, kind)
            if there is not None and not too_long(search.space, there.point, c.id):
                yield k, c.id, there


def _instead(search: Search, own: type[Cause], other: type[Cause]) -> Fitted | None:
    """Refitted with another cause that is as late; None where it cannot be played."""
    point = search.fitted.point
    stage = point.model.stage(own.id)
    assert stage is not None
    seconds = float(np.clip(stage[own.lasting], *other.limits[other.lasting]))
    model = point.model.without(own.id).with_stage(other.of(None, **{other.lasting: seconds}))
    sizes = tuple(
        (other.id, other.lasting, size) if (id, name) == (own.id, own.lasting) else (id, name, size)
        for id, name, size in point.sizes
        if id != own.id or name == own.lasting
    )
    try:
        return as_late(
            search.space, refit(search.space, Point(model, point.fixed, sizes), held=True), other.id
        )
    except (InputError, np.linalg.LinAlgError):
        return None
