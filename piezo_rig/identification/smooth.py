"""How much neighbouring compliances differ: learnt from the data, and what it hides.

A grid of break points never holds the true ones. Instead of a few free bands,
whose error all sweeps share and no comparison of sweeps can show, a fit has
many bands whose neighbours are tied: c[j+1] - c[j] is normal with mean 0 and a
step that is estimated by marginal likelihood (restricted: level and all other
unknowns are free). That is a linear smoothing spline of the compliance, seen as
the posterior mean under its Bayesian prior (Wahba 1978, J. R. Statist. Soc. B
40, 364; 1983, B 45, 133). The posterior's spread then contains what smoothing
takes away and what the data cannot tell, so that bands cover the truth on
average along the curve (Nychka 1988, J. Am. Statist. Ass. 83, 1134).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.identification.curves import Curves
from piezo_rig.identification.solve import UNSEEN

FloatArray = NDArray[np.float64]
Runs = tuple[tuple[int, int], ...]
START = 0.05  # of the mean compliance: the step from which the search sets out
TINY = 1e-12  # of the largest: keeps what data and ties hardly tell from being singular
LEAST = 1e-9  # of the largest: ties are never weaker
WIDEST = 1e6  # the search goes down by no more than this factor
LARGEST = 100.0  # and up by this one


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of the unknowns before the data.

    Attributes
    ----------
    noise : variance of a sample, um^2, as large as one of white noise that tells as much
    runs : (first, one past last) index of the tied compliances of every curve
    steps : for every run, standard deviation of c[j+1] - c[j], um/V
    others : (probability, fit) of fits with other break points, the likeliest first
    weight : held-out data want the penalty to be this many times what the steps say
    least : the penalty is never weaker, so that rounding does not decide what the data leave open
    """

    noise: float
    runs: Runs
    steps: tuple[float, ...]
    others: tuple[tuple[float, Curves], ...] = ()
    weight: float = 1.0
    least: float = 0.0

    def strength(self, step: float) -> float:
        """Weight of a squared step."""
        return max(self.weight * self.noise / step**2, self.least)

    def penalty(self, size: int) -> FloatArray:
        """What the Gram matrix gains, shape (size, size)."""
        out = np.zeros((size, size))
        for (a, b), step in zip(self.runs, self.steps, strict=True):
            out[a:b, a:b] += self.strength(step) * differences(b - a)
        return out

    def effective(self, gram: FloatArray) -> float:
        """How many free compliances would do as much as the tied ones do."""
        shrink = inverse(gram + self.penalty(gram.shape[0])) @ gram
        return float(sum(np.trace(shrink[a:b, a:b]) for a, b in self.runs))


@dataclass(frozen=True, eq=False)
class Hidden:
    """What a tied fit hides, about the untied one.

    Attributes
    ----------
    shrink : shape (p, p), steps of the tied fit = shrink @ steps of the untied fit
    root : shape (p, p), root of the posterior covariance that is not the data's scatter
    posterior : shape (p, p), inverse of the Gram matrix with the penalty
    gram : shape (p, p), without it
    """

    shrink: FloatArray
    root: FloatArray
    posterior: FloatArray
    gram: FloatArray

    @classmethod
    def of(cls, prior: Prior, gram: FloatArray) -> Hidden:
        size = gram.shape[0]
        posterior = inverse(gram + prior.penalty(size))
        root = np.zeros((size, size))
        for (a, b), step in zip(prior.runs, prior.steps, strict=True):
            d = np.diff(np.eye(b - a), axis=0)
            root[a:b, a : b - 1] = prior.strength(step) * step * d.T
        return cls(posterior @ gram, posterior @ root, posterior, gram)


def differences(n: int) -> FloatArray:
    """D'D of the differences between n neighbours, shape (n, n)."""
    d = np.diff(np.eye(n), axis=0)
    return np.asarray(d.T @ d, float)


def inverse(matrix: FloatArray) -> FloatArray:
    """Of a Gram matrix whose columns differ in size; 0 where a column was never visited."""
    diagonal = np.diag(matrix)
    seen = diagonal > UNSEEN * diagonal.max()
    scale = 1.0 / np.sqrt(diagonal[seen])
    part = np.linalg.inv(matrix[np.ix_(seen, seen)] * np.outer(scale, scale))
    out = np.zeros_like(matrix)
    out[np.ix_(seen, seen)] = part * np.outer(scale, scale)
    return out


def learnt(
    gram: FloatArray, right: FloatArray, noise: float, runs: Runs, x: FloatArray
) -> Prior:
    """The steps that make the data most probable.

    Parameters
    ----------
    gram, right : shapes (p, p), (p,), of all data, for the unknowns themselves
    noise : see `Prior`
    runs : see `Prior`; those that the data never visit are left out
    x : shape (p,), a fit, for the size of compliances
    """
    from scipy.linalg import cho_factor, cho_solve
    from scipy.optimize import minimize

    diagonal = np.diag(gram)
    seen = diagonal > UNSEEN * diagonal.max()
    kept = tuple((a, b) for a, b in runs if b - a > 1 and np.any(seen[a:b]))
    for a, b in kept:
        seen[a:b] = True
    start = [START * float(np.mean(np.abs(x[a:b]))) for a, b in kept]
    if not kept:
        return Prior(noise, (), ())
    scale = 1.0 / np.sqrt(np.where(seen & (diagonal > 0), diagonal, diagonal.max()))[seen]
    outer = np.outer(scale, scale) * gram[np.ix_(seen, seen)], right[seen] * scale

    def minus_twice_log_likelihood(logs: FloatArray) -> float:
        logs = np.clip(logs, -np.log(WIDEST), np.log(LARGEST))
        steps = tuple(s * float(np.exp(v)) for s, v in zip(start, logs, strict=True))
        penalty = Prior(noise, kept, steps).penalty(x.size)[np.ix_(seen, seen)]
        scaled = outer[0] + penalty * np.outer(scale, scale)
        scaled[np.diag_indices_from(scaled)] += TINY
        factor = cho_factor(scaled, lower=True)
        fitted = float(outer[1] @ cho_solve(factor, outer[1])) / noise
        size = 2.0 * float(np.sum(np.log(np.diag(factor[0]))))
        free = sum((b - a - 1) * 2.0 * np.log(s) for (a, b), s in zip(kept, steps, strict=True))
        return size + float(free) - fitted

    found = minimize(
        minus_twice_log_likelihood, np.zeros(len(kept)), method="Nelder-Mead",
        options={"xatol": 0.02, "fatol": 0.02, "initial_simplex": _simplex(len(kept))},
    )  # fmt: skip
    logs = np.clip(found.x, -np.log(WIDEST), np.log(LARGEST))
    steps = tuple(s * float(np.exp(v)) for s, v in zip(start, logs, strict=True))
    return Prior(noise, kept, steps, least=LEAST * float(diagonal.max()))


def _simplex(n: int) -> FloatArray:
    return np.vstack([np.zeros(n), -2.0 * np.eye(n)])
