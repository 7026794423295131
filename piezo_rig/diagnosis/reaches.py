"""At which reach a law of the first spring holds, and how well the data know that.

About a fit everything is linear but for one thing: how far after a turning point such a law holds,
and whether it ends there or fades out. The evidence has several summits over that, and between
them the law is a different one: half as far it is about twice as strong, and its constant part
runs away as the reach goes to nothing. So at the end all reaches that the data allow are fitted,
the best is kept, and intervals are those of the mixture, every fit weighed by its evidence. So it
is with causes that have other forms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from piezo_rig.causes.cause import Cause
from piezo_rig.causes.first_spring import FirstSpring
from piezo_rig.chain import Stage
from piezo_rig.diagnosis.abreast import abreast
from piezo_rig.diagnosis.chances import normal_below
from piezo_rig.diagnosis.first_spring import offset_of
from piezo_rig.diagnosis.forms import at_values, begun_in, most_alike, summit, taper_of, worth_of
from piezo_rig.diagnosis.ladder import Ladder
from piezo_rig.diagnosis.refit import Fitted, refit
from piezo_rig.diagnosis.space import Space
from piezo_rig.errors import InputError

FloatArray = NDArray[np.float64]
Intervals = dict[tuple[str, str], tuple[float, float]]  # of (stage, parameter)
STEP = 2.0**0.25  # between reaches
LEAST, MOST, ONCE_MORE = 3, 10, 1  # steps to either side; at least where it was looked at before
NEGLIGIBLE = 6.0  # log-likelihood below the best
FAR = 60.0  # the same of a form, at the other one's reach, that is not looked at further
WORSE = 1.01  # held-out error at another reach, of that before
AS_LIKELY = 3.0  # log-likelihood below the best of a form that may be the better one all the same
HARDLY = 0.1  # of its interval, by which a parameter has hardly moved
BETTER = 0.5  # log-likelihood that another reach must be better by
TAIL = 0.025


class Known(NamedTuple):
    """A law where it came out, if it is the latest that was looked at, and its intervals."""

    stage: Stage | None
    intervals: Intervals


def at_their_reaches(
    space: Space, ladder: Ladder, held_out: Callable[[Fitted], float],
    known: Mapping[str, Known] | None = None,
) -> tuple[Ladder, dict[str, Known]]:
    """The ladder with every law of its last rung at its best reach, and what is known of each.

    Parameters
    ----------
    held_out : rms error of a rung; what raises it is not the better reach
    known : what came out before; laws that have hardly moved since are not looked at again
    """
    out: dict[str, Known] = {}
    for id in [s.cause for s in ladder.steps]:
        if known and id in known and _unmoved(ladder.last, known[id], id):
            out[id] = known[id]
            continue
        try:
            wide = LEAST if not known or id not in known else ONCE_MORE
            fitted, found = over_reaches(space, ladder.last, id, held_out, wide)
            if not found:
                fitted, found = over_forms(space, ladder.last, id)
        except (InputError, np.linalg.LinAlgError):
            continue  # what cannot be played elsewhere stays where it is
        if fitted is not ladder.last:
            if held_out(fitted) > WORSE * held_out(ladder.last):
                continue
            steps = (*ladder.steps[:-1], replace(ladder.steps[-1], fitted=fitted))
            ladder = replace(ladder, steps=steps)
            # those before were looked at beside another law
            out = {other: known_of._replace(stage=None) for other, known_of in out.items()}
        out[id] = Known(fitted.point.model.stage(id), found)
    return ladder, out


def _unmoved(fitted: Fitted, before: Known, id: str) -> bool:
    """Whether a law is in the form that it had, and well within its intervals still."""
    stage = fitted.point.model.stage(id)
    if stage is None or before.stage is None:
        return False
    if set(stage.parameters) != set(before.stage.parameters):
        return False
    moved = {n for n in stage.parameters if stage[n] != before.stage[n]}
    return all(
        (id, n) in before.intervals
        and abs(stage[n] - before.stage[n]) < HARDLY * np.ptp(before.intervals[id, n])
        for n in moved
    )


def over_reaches(
    space: Space, fitted: Fitted, id: str, held_out: Callable[[Fitted], float], least: int = LEAST
) -> tuple[Fitted, Intervals]:
    """The fit at a law's best reach, and intervals of its parameters, the constant part included;
    none for what is no such law.

    Of forms that are about as likely, the one that predicts best what it was not fitted to.
    ``least`` : steps to either side in any case
    """
    stage = fitted.point.model.stage(id)
    names = [n for i, n in fitted.point.names if i == id]
    if not isinstance(stage, Cause) or "reach" not in names or fitted.point.fixed:
        return fitted, {}
    tried = _all_about(space, fitted, id, fitted.evidence, least)
    here = max(tried, key=lambda f: f.evidence)
    forms = [
        at_values(
            space, here, id, {"taper": t, "reach": most_alike(space, here, id, t)}, here.linear
        )
        for t in stage.tapers if t != stage["taper"]
    ]  # fmt: skip
    other, most = max(forms, key=lambda f: worth_of(f, id), default=here), worth_of(here, id)
    if taper_of(other, id) != stage["taper"] and worth_of(other, id) > most - FAR:
        tried += _all_about(space, other, id, most, least)
    tried = [fitted, *(f for f in tried[1:] if _inside(f, id))]
    most = max(worth_of(f, id) for f in tried)
    near = []
    for taper in stage.tapers:
        same = [f for f in tried if taper_of(f, id) == taper]
        if same and max(worth_of(f, id) for f in same) > most - NEGLIGIBLE:
            near.append(partial(summit, space, max(same, key=lambda f: f.evidence), id))
    tried += abreast(space, near, fitted.parts)
    worth = np.array([worth_of(f, id) for f in tried])
    best = _best(tried, worth, id, held_out)
    if worth.max() > worth[0] + BETTER or taper_of(best, id) != stage["taper"]:
        fitted = refit(space, best.point, steps=2, held=True)
    kept = [k for k in range(len(tried)) if worth[k] > worth.max() - NEGLIGIBLE]
    weights = np.exp(worth[kept] - worth.max()) * _widths([tried[k] for k in kept], id)
    weights /= weights.sum()
    found = [_known(tried[k], id, names) for k in kept]
    return fitted, {
        (id, n): _interval(weights, [k[n] for k in found]) for n in found[0]
    }


def _best(
    tried: Sequence[Fitted], worth: FloatArray, id: str, held_out: Callable[[Fitted], float]
) -> Fitted:
    """The likeliest fit; one of another form where that is about as likely and predicts better."""
    order = [tried[k] for k in np.argsort(-worth) if worth[k] > worth.max() - AS_LIKELY]
    best, seen = order[0], {taper_of(order[0], id)}
    for other in order[1:]:
        if taper_of(other, id) not in seen:
            seen.add(taper_of(other, id))
            if held_out(other) * WORSE < held_out(best):
                best = other
    return best


def over_forms(space: Space, fitted: Fitted, id: str) -> tuple[Fitted, Intervals]:
    """The fit in a cause's likeliest form, and intervals over all that the data allow."""
    stage = fitted.point.model.stage(id)
    forms = stage.otherwise() if isinstance(stage, Cause) else []
    tried = [fitted]
    for form in forms:
        other = begun_in(space, fitted, form)
        if other is not None:
            tried.append(other)
    worth = np.array([f.evidence for f in tried])
    kept = [k for k in range(len(tried)) if worth[k] > worth.max() - NEGLIGIBLE]
    best = tried[int(np.argmax(worth))] if worth.max() > worth[0] + BETTER else fitted
    if len(kept) < 2:
        return best, {}
    weights = np.exp(worth[kept] - worth.max())
    weights /= weights.sum()
    spread = {}
    for k, (owner, name) in enumerate(fitted.point.names):
        if owner == id:
            parts = [
                (_stage(tried[i], id)[name], float(np.sqrt(max(tried[i].covariance[k, k], 0.0))))
                for i in kept
            ]
            spread[id, name] = _interval(weights, parts)
    return best, spread


def _all_about(
    space: Space, fitted: Fitted, id: str, most: float, least: int
) -> list[Fitted]:
    """Fits for reach after reach, to either side until the data allow no more.

    ``most`` : evidence that is known from elsewhere
    """
    both = [partial(_to_one_side, space, fitted, id, most, by, least) for by in (STEP, 1.0 / STEP)]
    return [fitted, *(f for side in abreast(space, both, fitted.parts) for f in side)]


def _to_one_side(
    space: Space, fitted: Fitted, id: str, most: float, factor: float, least: int
) -> list[Fitted]:
    """Until it is worth far less than the best, and no longer more than the one before."""
    out, here = [], fitted
    for k in range(MOST):
        reach = {"reach": factor * _stage(here, id)["reach"]}
        there = at_values(space, here, id, reach, here.linear)
        rising = there.evidence > here.evidence + BETTER
        if there is here or (
            k >= least and there.evidence < most - NEGLIGIBLE and not rising
        ):  # fmt: skip
            break
        most, here = max(most, there.evidence), there
        out.append(there)
    return out


def _stage(fitted: Fitted, id: str) -> Cause:
    stage = fitted.point.model.stage(id)
    assert isinstance(stage, Cause)
    return stage


def _inside(fitted: Fitted, id: str) -> bool:
    """Whether no parameter has run into its limit."""
    stage = _stage(fitted, id)
    return all(low < stage[n] < high for n, (low, high) in stage.limits.items())


def _widths(fits: Sequence[Fitted], id: str) -> FloatArray:
    """What stretch of the logarithm of the reach each fit stands for, among those of its form."""
    out = np.zeros(len(fits))
    for taper in {taper_of(f, id) for f in fits}:
        own = [k for k, f in enumerate(fits) if taper_of(f, id) == taper]
        at = np.array([np.log(_stage(fits[k], id)["reach"]) for k in own])
        order = np.argsort(at)
        edges = np.concatenate([[-np.inf], 0.5 * np.diff(at[order]) + at[order][:-1], [np.inf]])
        half, at = 0.5 * np.log(STEP), at[order]
        low, high = np.maximum(edges[:-1], at - half), np.minimum(edges[1:], at + half)
        out[[own[k] for k in order]] = np.maximum(high - low, 1e-9)
    return out


def _known(fitted: Fitted, id: str, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Value and standard error of every parameter, the reach being what it is."""
    stage = fitted.point.model.stage(id)
    assert isinstance(stage, Cause)
    at = fitted.point.names.index((id, "reach"))
    follows = fitted.covariance[:, at]
    given = fitted.covariance - np.outer(follows, follows) / max(float(follows[at]), 1e-300)
    fitted = replace(fitted, covariance=given)
    out = {}
    for n in names:
        if n == "reach":
            out[n] = stage[n], stage[n] * np.log(STEP) / 4.0
            continue
        k = fitted.point.names.index((id, n))
        out[n] = stage[n], float(np.sqrt(max(given[k, k], 0.0)))
    if isinstance(stage, FirstSpring):
        offset = offset_of(fitted, stage)
        if offset.ci95 is not None:
            out["offset"] = offset.value, (offset.ci95[1] - offset.ci95[0]) / 3.92
    return out


def _interval(weights: FloatArray, parts: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Between the tails of a mixture of normal laws."""
    mean = np.array([m for m, _ in parts])
    spread = np.maximum([s for _, s in parts], 1e-300 + 1e-9 * np.abs(mean))
    low, high = float(np.min(mean - 9.0 * spread)), float(np.max(mean + 9.0 * spread))

    def below(x: float) -> float:
        return float(weights @ normal_below((x - mean) / spread))

    return (
        float(brentq(lambda x: below(x) - TAIL, low, high)),
        float(brentq(lambda x: below(x) - 1.0 + TAIL, low, high)),
    )
