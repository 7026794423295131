"""Tails of the usual distributions, from `scipy.special`: `scipy.stats` takes a second to load."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

FloatArray = NDArray[np.float64]
TWO_SIDED = 0.975  # of a distribution below the upper end of its 95 % interval
AS_HELD = 1.2  # times as wide as fits say, intervals hold as often as they should: decision 45


def normal_below(x: ArrayLike) -> FloatArray:
    """Chance of less than ``x`` standard deviations above the mean."""
    return np.asarray(special.ndtr(x))


def normal_above(x: float) -> float:
    """Chance of more than ``x`` standard deviations above the mean."""
    return float(special.ndtr(-x))


def normal_half_width() -> float:
    """Standard deviations that a 95 % interval reaches to either side."""
    return float(special.ndtri(TWO_SIDED))


def as_held(low: float, high: float, logarithmic: bool = False) -> tuple[float, float]:
    """An interval as a fit has it, as wide as intervals have to be to hold.

    ``logarithmic`` : of what is above zero, and known by its ratio
    """
    if logarithmic:
        wide = as_held(float(np.log(low)), float(np.log(high)))
        return float(np.exp(wide[0])), float(np.exp(wide[1]))
    middle, half = 0.5 * (low + high), 0.5 * AS_HELD * (high - low)
    return middle - half, middle + half


def student_half_width(freedom: float) -> float:
    """The same of Student's law."""
    return float(special.stdtrit(freedom, TWO_SIDED))


def student_above(x: float, freedom: float) -> float:
    """Chance of more than ``x``."""
    return float(special.stdtr(freedom, -x))


def fisher_above(x: float, freedom: float, below: float) -> float:
    """Chance that a ratio of two mean squares, of so many normal numbers each, is above ``x``."""
    return float(special.fdtrc(freedom, below, x))


def chi2_above(x: ArrayLike, freedom: ArrayLike) -> FloatArray:
    """Chance that a sum of squares of so many standard normal numbers is above ``x``."""
    return np.asarray(special.chdtrc(freedom, x))


def chi2_at(above: float, freedom: float) -> float:
    """What such a sum exceeds with a chance of ``above``."""
    return float(special.chdtri(freedom, above))


def gamma_above(x: float, shape: float, scale: float) -> float:
    """Chance of more than ``x`` under a gamma law."""
    return float(special.gammaincc(shape, max(x, 0.0) / scale))


def poisson_above(count: int, mean: float) -> float:
    """Chance of more than ``count`` events."""
    return float(special.pdtrc(count, mean)) if count >= 0 else 1.0
