"""How well parameters are known where it is open by how much the model may be wrong.

Fits and their covariances are for the likeliest variances of fine thresholds and dictionary. The
data seldom know those well, and larger ones leave more open; so do other values that they prefer.
Intervals are of the mixture over the whole grid, every pair of variances weighed by its evidence.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezo_rig.diagnosis.likelihood import Likelihood
from piezo_rig.diagnosis.reduction import reduce
from piezo_rig.diagnosis.refit import Fitted, parameter_step

FloatArray = NDArray[np.float64]
NEGLIGIBLE = 5.0  # log-likelihood below the best


def over_scales(fitted: Fitted) -> FloatArray:
    """Mean square distance (q, q) of the stage parameters from the fit's, over both variances."""
    point = fitted.point
    n, q = point.linear, len(point.sizes)
    if q == 0 or fitted.covariance.shape != (q, q):
        return fitted.covariance
    linear = fitted.linear
    likelihood = Likelihood(reduce(linear, free=range(n, n + q)))
    worth = likelihood.grid(range(-q, 0))
    best = max(worth.values())
    kept = {s: np.exp(v - best) for s, v in worth.items() if v > best - NEGLIGIBLE}
    out, total = np.zeros((q, q)), sum(kept.values())
    for scales, weight in kept.items():
        moved, covariance = parameter_step(point, linear, scales, held=True)
        out += weight / total * (covariance + np.outer(moved, moved))
    return out
