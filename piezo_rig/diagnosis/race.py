"""Causes that are about as likely, refitted side by side: what each is worth then."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.diagnosis.abreast import abreast
from piezo_rig.diagnosis.bends import BEND
from piezo_rig.diagnosis.grown import FAR_BEHIND, Tried, grown
from piezo_rig.diagnosis.needed import at_a_limit, too_long
from piezo_rig.diagnosis.put_in import plainer, refitted
from piezo_rig.diagnosis.refit import Fitted, gained
from piezo_rig.diagnosis.refusals import FAR_OFF, MUCH, TOO_LONG
from piezo_rig.diagnosis.scan import LEVEL, Form, Found, Scan, by_speed, has_reach, of_base
from piezo_rig.diagnosis.steep import begun_steep
from piezo_rig.diagnosis.twins import twins_of

if TYPE_CHECKING:
    from piezo_rig.diagnosis.climb import Search

PROMISING = 2  # that are refitted because the likeliest came to less
A_FACTOR, NEARLY = 0.7, 1.1  # of what a bend says; and of what it leaves held out
OF_ANOTHER = 1.0  # log-likelihood by a linear look, up to which no other kind of bend is tried


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
    out += tried(search, here, found, _promising(result, out), out)
    out += tried(search, here, found, [i for i in result.as_flat(good) if i not in close], out)
    steep = begun_steep(search, here, found, out)
    search.steep = [i for _, i, _ in steep]
    out = [t for t in out if t[1] not in search.steep] + steep
    out += tried(search, here, found, twins_of(search, result, out), out)
    bends = [i for i, id in enumerate(result.ids) if of_base(id) and i not in close]
    # what a bend of another kind leaves looks like a law, or an asymmetry
    bent = here.point.model.stage(BEND) is not None and (
        any(result.ratio[i] > OF_ANOTHER for i in bends)
    )
    if bends and (bent or _still_far_off(search, here, [fitted for _, _, fitted in out])):
        out += tried(search, here, found, bends)
    return _rather_a_factor(search, here, found, out), bool(close)


def _rather_a_factor(
    search: Search, here: Fitted, found: Found, out: list[Tried]
) -> list[Tried]:
    """Against a given model that says how far off it was: no bend where a gain or a sensitivity
    says nearly as much. Such a model has its own bend, which does not change, and one more does
    most of what a factor does.
    """
    bends = [t for t in out if of_base(found.result.ids[t[1]]) and t[0] > 0.0]
    space = search.space
    if not bends or not space.held or space.loose or not np.isfinite(space.own_um):
        return out
    factors = [i for i, id in enumerate(found.result.ids) if _of_given(id)]
    out = out + tried(search, here, found, [i for i in factors if i not in {t[1] for t in out}])
    said = [t for t in out if t[1] in factors]

    def needless(bend: Tried) -> bool:
        error = NEARLY * search.error(0, bend[2])
        return any(
            gained(f, here) > A_FACTOR * gained(bend[2], here) and search.error(0, f) < error
            for _, _, f in said
        )

    return [t for t in out if t not in bends or not needless(t)]


def _of_given(id: str) -> bool:
    kind = CAUSES[id]
    return issubclass(kind, Cause) and kind.needs_fixed_model


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
    doubted = {
        i: form for i in slow
        if i not in forms and (fitted := refits[i]) is not None
        and search.error(0, fitted) > search.error(0, here)
        and (form := plainer(found, result.ids[i], doubted=True)) is not None
    }  # fmt: skip
    fits += abreast(search.space, [
        partial(refitted, search.space, here, found, i, form) for i, form in doubted.items()
    ], here.parts)  # fmt: skip
    for i, plain in zip((*forms, *doubted), fits[len(slow) :], strict=True):
        best = refits[i]
        if plain is not None and (
            best is None or search.error(0, plain) < search.error(0, best)
        ):  # fmt: skip
            refits[i] = plain
    begun = [(int(i), f) for i in close if (f := refits[int(i)]) is not None]
    for i in set(map(int, close)) - {i for i, _ in begun}:
        search.came_to_nothing(result.ids[i], here)
    rivals = [*(fitted for *_, fitted in before), *(f for _, f in begun)]
    most = max((gained(f, here) for f in rivals), default=0.0)
    known = [part for _, f in begun for part in f.parts]
    # laws first: their forms are many
    begun.sort(key=lambda b: not has_reach(result.ids[b[0]]))
    grow = [partial(grown, search, here, found, i, f, most) for i, f in begun]
    ends = abreast(search.space, grow, [*here.parts, *known])
    out: list[Tried] = []
    for (i, _), (worth, fitted, error) in zip(begun, ends, strict=True):
        id = result.ids[i]
        if at_a_limit(fitted.point, id, getattr(CAUSES[id], "scanned", ("",))[0]):
            search.came_to_nothing(id, here)
            continue
        if too_long(search.space, fitted.point, id):
            search.bar(id, here, TOO_LONG, 0.0)  # whatever else is found
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
    said = {i: gained(fitted, here) for _, i, fitted in fits}
    least = FAR_BEHIND * max(said.values(), default=0.0)
    near = any(
        max(said.get(i, 0.0), result.excess[i]) >= least
        for i in result.close(good) if by_speed(result.ids[i])
    )  # fmt: skip
    return result.alike(good) if near else []


def _promising(result: Scan, fits: Sequence[Tried]) -> list[int]:
    """What a linear look said more of than anything that was refitted turned out to be worth, if
    chance alone hardly says as much.

    Of the likeliest the refit may keep little, as of a delay that is a lag of the sliders.
    """
    if not fits:
        return []
    most = max(worth for worth, *_ in fits)
    known = {i for _, i, _ in fits}
    order = np.argsort(-result.excess)
    return [
        int(i) for i in order
        if result.excess[i] > most and result.p_family[i] < LEVEL
        and int(i) not in known and not of_base(result.ids[i])
    ][:PROMISING]


def _still_far_off(search: Search, here: Fitted, tried: Sequence[Fitted]) -> bool:
    """Whether a model is far off, and none of its extensions brings it much nearer."""
    error = search.error(0, here)
    if error < FAR_OFF * search.noise_nm or here.point.fixed:
        return False
    return min((search.error(0, fitted) for fitted in tried), default=error) > MUCH * error


def _slow(id: str) -> bool:
    """Whether a cause is begun from several places, as beside kinks."""
    kind = CAUSES[id]
    return issubclass(kind, Cause) and bool(kind.kinked or kind.bending)
