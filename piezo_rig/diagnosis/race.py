"""Causes that are about as likely, refitted side by side: what each is worth then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause, FirstSpring
from piezo_rig.diagnosis.abreast import abreast
from piezo_rig.diagnosis.bends import BEND
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.forms import CARRIES, carries, reached
from piezo_rig.diagnosis.needed import at_a_limit, worth_needed
from piezo_rig.diagnosis.put_in import LARGE, all_free, plainer, refitted
from piezo_rig.diagnosis.refit import Fitted, refit
from piezo_rig.diagnosis.refusals import FAR_OFF, MUCH
from piezo_rig.diagnosis.scan import Form, Found, Scan, by_speed, has_reach, of_base
from piezo_rig.diagnosis.space import Space
from piezo_rig.errors import InputError

if TYPE_CHECKING:
    from piezo_rig.diagnosis.climb import Search

FAR_BEHIND = 0.5  # of the best refit's gain: below it a rival's reach is not looked for
OF_ANOTHER = 1.0  # log-likelihood by a linear look, up to which no other kind of bend is tried
Tried = tuple[float, int, Fitted]  # what a cause is worth once refitted, its number, the refit


def raced(
    search: Search, here: Fitted, found: Found, good: NDArray[np.int64]
) -> tuple[list[Tried], bool]:
    """The likeliest causes, what may be taken for them, and where that may help other bends.

    Parameters
    ----------
    good : numbers of those that chance does not explain

    Returns
    -------
    tried : see `tried`
    any : whether there were any to refit but bends
    """
    result = found.result
    close = result.close(good)
    close = [*close, *(i for i in search.rather if i not in close)]
    out = tried(search, here, found, close)
    out += tried(search, here, found, _as_fast(here, result, good, out), out)
    out += tried(search, here, found, result.as_flat(good), out)
    out += _as_far(search, here, found, out)
    bends = [i for i, id in enumerate(result.ids) if of_base(id) and i not in close]
    # what a bend of another kind leaves looks like a law, or an asymmetry
    bent = here.point.model.stage(BEND) is not None and (
        any(result.ratio[i] > OF_ANOTHER for i in bends)
    )
    if bends and (bent or _still_far_off(search, here, [fitted for _, _, fitted in out])):
        out += tried(search, here, found, bends)
    return out, bool(close)


def tried(
    search: Search, here: Fitted, found: Found, close: Sequence[int] | NDArray[np.int64],
    before: Sequence[Tried] = (),
) -> list[Tried]:
    """What causes are worth once refitted, their numbers, the refits; without those of which
    nothing is left.

    ``before`` : others that they are compared with
    """
    if not len(close):
        return []
    result = found.result
    search.patience.spend(len(close))
    search.tell(f"refit with {' or '.join(result.ids[i] for i in close)}")
    slow = sorted(map(int, close), key=lambda i: not _slow(result.ids[i]))  # these first
    forms = {i: form for i in slow if (form := plainer(found, result.ids[i])) is not None}
    every: list[tuple[int, Form | None]] = [(i, None) for i in slow]
    every += forms.items()
    fits = abreast(search.space, [
        partial(refitted, search.space, here, found, i, form) for i, form in every
    ], here.parts)  # fmt: skip
    refits = dict(zip(slow, fits[: len(slow)], strict=True))
    for i, plain in zip(forms, fits[len(slow) :], strict=True):
        best = refits[i]
        if plain is not None and (
            best is None or search.error(0, plain) < search.error(0, best)
        ):  # fmt: skip
            refits[i] = plain
    begun = [(int(i), f) for i in close if (f := refits[int(i)]) is not None]
    for i in set(map(int, close)) - {i for i, _ in begun}:
        search.came_to_nothing(result.ids[i], here)
    rivals = [*(fitted for *_, fitted in before), *(f for _, f in begun)]
    most = max((f.evidence - here.evidence for f in rivals), default=0.0)
    known = [part for _, f in begun for part in f.parts]
    # laws first: their forms are many
    begun.sort(key=lambda b: not has_reach(result.ids[b[0]]))
    grow = [partial(_grown, search, here, found, i, f, most) for i, f in begun]
    grown = abreast(search.space, grow, [*here.parts, *known])
    out: list[Tried] = []
    for (i, _), (worth, fitted, error) in zip(begun, grown, strict=True):
        id = result.ids[i]
        if at_a_limit(fitted.point, id, getattr(CAUSES[id], "scanned", ("",))[0]):
            search.came_to_nothing(id, here)
            continue
        out.append((worth, i, fitted))
        if error is not None:
            search.keep_error(fitted, error)
    return out


def _as_fast(
    here: Fitted, result: Scan, good: NDArray[np.int64], fits: Sequence[Tried]
) -> list[int]:
    """What may be taken for the likeliest cause that goes by speed, unless that one neither
    promised nor gained nearly as much as the best refit.
    """
    gained = {i: fitted.evidence - here.evidence for _, i, fitted in fits}
    least = FAR_BEHIND * max(gained.values(), default=0.0)
    near = any(
        max(gained.get(i, 0.0), result.excess[i]) >= least
        for i in result.close(good) if by_speed(result.ids[i])
    )  # fmt: skip
    return result.alike(good) if near else []


def _as_far(
    search: Search, here: Fitted, found: Found, fits: Sequence[Tried]
) -> list[Tried]:
    """A spring that follows the range, begun at its size, where what goes by speed was refitted.

    Half loops that go further are faster, and open further. What a large one does on the average
    the elements have gone after, of what is left a linear look makes little, and no descent leads
    there from a small slope.
    """
    ids, space = found.result.ids, search.space
    if here.point.fixed or not any(worth > 0.0 and by_speed(ids[i]) for worth, i, _ in fits):
        return []
    out: list[Tried] = []
    for i, id in enumerate(ids):
        kind = CAUSES[id]
        if not (issubclass(kind, FirstSpring) and kind.like_speed) or i in [j for _, j, _ in fits]:
            continue
        search.tell(f"refit with {id}, begun steep")
        search.patience.spend(1)
        followed = np.concatenate([kind.history(g.loops) for g in space.groups.groups])
        mean_v = float(followed.mean()) if followed.size else 0.0
        points = [all_free(replace(here.point, model=here.point.model.with_stage(s)), s)
                  for s in kind.at_its_size(space.groups.travel_um, mean_v)]  # fmt: skip
        ends = abreast(space, [partial(_from_least_squares, space, p) for p in points], here.parts)
        best = max((f for f in ends if f is not None), key=lambda f: f.evidence, default=None)
        if best is None or best.evidence <= here.evidence:
            continue
        most = max(f.evidence for _, _, f in fits) - here.evidence
        worth, fitted, error = _grown(search, here, found, i, best, most)
        if worth <= 0.0 or at_a_limit(fitted.point, id, kind.scanned[0]):
            continue
        out.append((worth, i, fitted))
        if error is not None:
            search.keep_error(fitted, error)
    return out


def _from_least_squares(space: Space, point: Point) -> Fitted | None:
    """Refitted from where plain least squares ends: what else may be amiss takes in a part of a
    large effect, and holds it back.
    """
    try:
        return refit(space, refit(space, point, held=True, plain=True).point, held=True)
    except (InputError, np.linalg.LinAlgError):
        return None


def _still_far_off(search: Search, here: Fitted, tried: Sequence[Fitted]) -> bool:
    """Whether a model is far off, and none of its extensions brings it much nearer."""
    error = search.error(0, here)
    if error < FAR_OFF * search.noise_nm or here.point.fixed:
        return False
    return min((search.error(0, fitted) for fitted in tried), default=error) > MUCH * error


def _grown(
    search: Search, here: Fitted, found: Found, i: int, fitted: Fitted, most: float
) -> tuple[float, Fitted, float | None]:
    """A refit at its best reach; what it is worth, and its held-out error if that matters."""
    id = found.result.ids[i]
    # a law that is steep may be far behind until it is begun so
    steep = most < LARGE and issubclass(CAUSES[id], FirstSpring)
    if steep or fitted.evidence - here.evidence >= FAR_BEHIND * most:
        fitted = reached(search.space, fitted, id, here)
    chance = 2.0 * found.result.null_median[i] + worth_needed(fitted, id)
    chance += CARRIES * carries(fitted, id)
    worth = float(fitted.evidence - here.evidence - chance)
    return worth, fitted, search.error(0, fitted) if worth > 0.0 else None


def _slow(id: str) -> bool:
    """Whether a cause is begun from several places, as beside kinks."""
    kind = CAUSES[id]
    return issubclass(kind, Cause) and bool(kind.kinked or kind.bending)
