"""The score of every cause against the same null, and its calibration.

The null distribution of each cause's likelihood ratio comes from data simulated from the fitted
null, its tail from a gamma law.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.diagnosis.chances import gamma_above
from piezo_rig.diagnosis.likelihood import GRID, Likelihood, Seen, followed

FloatArray = NDArray[np.float64]
NULLS, MANY = 200, 1600  # drawn at first, and where a chance is within so much of its level
CLOSE_BY = 20.0
PLAIN = 200.0  # log-likelihood of a cause, beside which those of doubtful chance are not looked at


@dataclass(frozen=True, eq=False)
class Scored:
    """Log-likelihood ratios of several causes against the same null.

    Attributes
    ----------
    ratio : shape (c,), log-likelihood gained
    p_value : shape (c,), from the gamma tail of the simulated nulls; not corrected
    null_median : shape (c,)
    chosen : shape (c,), the best hypothesis of each cause
    """

    ratio: FloatArray
    p_value: FloatArray
    null_median: FloatArray
    chosen: NDArray[np.int64]


def score(
    likelihood: Likelihood,
    hypotheses: Sequence[Sequence[int]],
    owners: Sequence[int],
    rng: np.random.Generator,
    level: float,
    nulls: int = NULLS,
) -> Scored:
    """Score causes, each with one or several sets of trial columns of which the best counts.

    ``owners`` : for every hypothesis the number of its cause, 0, 1, ..
    ``level`` : of the chances; for causes that are close to it, many more nulls are drawn
    """
    z = likelihood.reduced.z[:, None]
    k = likelihood.summit()
    y = np.concatenate([z, likelihood.drawn(k, rng, nulls)], axis=1)
    columns, places = _asked_for(hypotheses, likelihood.reduced.trials.shape[1])
    best_null = np.full(y.shape[1], -np.inf)
    best = np.full((len(hypotheses), y.shape[1]), -np.inf)
    for i in range(GRID.size):
        for seen in likelihood.seen(i, y, columns):
            best_null = np.maximum(best_null, seen.plain)
            best = np.maximum(best, seen.plain + 0.5 * _gained(seen, places))
    owner = np.asarray(owners, int)
    causes = int(owner.max()) + 1
    ratio = np.full((causes, y.shape[1]), -np.inf)
    np.maximum.at(ratio, owner, best - best_null)
    chosen = np.array(
        [int(np.flatnonzero(owner == c)[np.argmax(best[owner == c, 0])]) for c in range(causes)]
    )
    p_value = np.array([tail(r[0], r[1:]) for r in ratio])
    median = np.median(ratio[:, 1:], axis=1)
    doubted = np.array([c for c in range(causes) if close_by(p_value[c], level)], int)
    if nulls < MANY and doubted.size and ratio[:, 0].max() < PLAIN:
        theirs = np.flatnonzero(np.isin(owner, doubted))
        again = score(
            likelihood, [hypotheses[int(h)] for h in theirs],
            [int(n) for n in np.searchsorted(doubted, owner[theirs])], rng, level, MANY,
        )  # fmt: skip
        p_value[doubted], median[doubted] = again.p_value, again.null_median
    return Scored(ratio[:, 0], p_value, median, chosen)


def _asked_for(
    hypotheses: Sequence[Sequence[int]], count: int
) -> tuple[NDArray[np.int64], list[list[int]]]:
    """Which of so many columns are in any hypothesis, and where among them each one's are."""
    columns = np.unique(np.array([k % count for h in hypotheses for k in h], int))
    return columns, [
        [int(n) for n in np.searchsorted(columns, [k % count for k in h])] for h in hypotheses
    ]


def score_generic(
    likelihood: Likelihood, rng: np.random.Generator, level: float, nulls: int = NULLS
) -> tuple[float, float]:
    """Log-likelihood ratio of the dictionary's scale against 0, and its p-value."""
    rows = range(GRID.size)
    k = max(rows, key=lambda i: likelihood.values(i)[0]), 0
    y = np.concatenate([likelihood.reduced.z[:, None], likelihood.drawn(k, rng, nulls)], axis=1)
    null = np.full(y.shape[1], -np.inf)
    full = np.full(y.shape[1], -np.inf)
    for i in rows:
        for j, seen in enumerate(likelihood.seen(i, y)):
            full = np.maximum(full, seen.plain)
            if j == 0:
                null = np.maximum(null, seen.plain)
    ratio = full - null
    p_value = tail(float(ratio[0]), ratio[1:])
    if nulls < MANY and close_by(p_value, level):
        return score_generic(likelihood, rng, level, MANY)
    return float(ratio[0]), p_value


def _gained(seen: Seen, hypotheses: Sequence[Sequence[int]]) -> FloatArray:
    """Squared length (h, k) of the data's part along the columns of every hypothesis."""
    out = np.zeros((len(hypotheses), seen.plain.size))
    lengths = np.array([len(h) for h in hypotheses])
    for n in set(lengths.tolist()) - {0}:
        where = np.flatnonzero(lengths == n)
        of = np.array([list(h) for h in hypotheses if len(h) == n])
        out[where] = followed(seen.gram[of[:, :, None], of[:, None, :]], seen.along[of])
    return out


def close_by(p_value: float, level: float) -> bool:
    """Whether a chance of few draws may well be on the other side of its level.

    Of the same ratio, two hundred draws have said 5e-4 and 5e-3.
    """
    return level / CLOSE_BY < p_value < level * CLOSE_BY


def tail(value: float, nulls: FloatArray) -> float:
    """Chance of a value at least this large, from a gamma law through the nulls' moments."""
    x = np.maximum(nulls, 0.0)
    mean, spread = float(x.mean()), float(x.std(ddof=1))
    if value <= 0.0:
        return 1.0
    if mean <= 0.0 or spread <= 0.0:
        return 1.0 / (nulls.size + 1)
    # moments wobble: the tail is taken a little heavier than they say
    spread *= 1.0 + 1.0 / np.sqrt(2.0 * nulls.size)
    shape = (mean / spread) ** 2
    p = gamma_above(value, shape, spread**2 / mean)
    return max(p, 1e-300)
