"""How well the data know a law whose reach they hardly know.

About a fit everything is linear but for one thing: how far after a turning point a law of the first
spring holds. A law that holds half as far is about twice as strong, and its constant part runs
away as the reach goes to nothing. Where the reach is uncertain by a good part of itself, intervals
are those of a mixture: a fit for every reach that the data allow, weighed by its evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import brentq

from piezo_rig.causes.cause import Cause, FirstSpring
from piezo_rig.diagnosis.first_spring import offset_of
from piezo_rig.diagnosis.forms import at_values
from piezo_rig.diagnosis.refit import Fitted
from piezo_rig.diagnosis.space import Space

FloatArray = NDArray[np.float64]
Intervals = dict[tuple[str, str], tuple[float, float]]  # of (stage, parameter)
SHARP = 0.1  # standard error of a reach, of itself, up to which it is left as it is
STEP, MOST = 2.0**0.25, 10  # between reaches, and how many to either side
NEGLIGIBLE = 6.0  # log-likelihood below the best
TAIL = 0.025


def over_reaches(space: Space, fitted: Fitted, id: str) -> Intervals:
    """Intervals (95 %) of a law's parameters, its constant part included; none where linear ones
    do.
    """
    stage = fitted.point.model.stage(id)
    names = [n for i, n in fitted.point.names if i == id]
    if not isinstance(stage, Cause) or "reach" not in names or fitted.point.fixed:
        return {}
    at = fitted.point.names.index((id, "reach"))
    if np.sqrt(max(fitted.covariance[at, at], 0.0)) < SHARP * stage["reach"]:
        return {}
    tried = [fitted, *_towards(space, fitted, id, STEP), *_towards(space, fitted, id, 1.0 / STEP)]
    best = max(f.evidence for f in tried)
    weights = np.array([np.exp(f.evidence - best) for f in tried])
    weights /= weights.sum()
    found = [_known(f, id, names) for f in tried]
    out = {
        (id, n): _interval(weights, [k[n] for k in found])
        for n in found[0] if n != "reach"
    }  # fmt: skip
    reaches = [(_reach(f, id), _reach(f, id) * np.log(STEP) / 2.0) for f in tried]
    return out | {(id, "reach"): _interval(weights, reaches)}


def _towards(space: Space, fitted: Fitted, id: str, factor: float) -> list[Fitted]:
    """Fits for reach after reach, until the data allow no more."""
    out: list[Fitted] = []
    best, here = fitted.evidence, fitted
    for _ in range(MOST):
        there = at_values(space, here, id, {"reach": factor * _reach(here, id)})
        if there is here or there.evidence < best - NEGLIGIBLE:
            break
        best, here = max(best, there.evidence), there
        out.append(there)
    return out


def _reach(fitted: Fitted, id: str) -> float:
    stage = fitted.point.model.stage(id)
    assert stage is not None
    return stage["reach"]


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
        return float(weights @ stats.norm.cdf((x - mean) / spread))

    return (
        float(brentq(lambda x: below(x) - TAIL, low, high)),
        float(brentq(lambda x: below(x) - 1.0 + TAIL, low, high)),
    )
