"""A straight line through points, with the uncertainty of both of its coefficients.

Source: JCGM 100:2008 (GUM), section H.3, calibration of a thermometer by least squares; degrees of
freedom and the quantile of Student's distribution for few points, sections G.3 and G.6. Stated
uncertainties are weights; where the points scatter more than they allow, the result is enlarged
by the Birge ratio (R. T. Birge, Phys. Rev. 40 (1932) 207).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Line:
    """y = slope x + intercept.

    Attributes
    ----------
    slope, intercept : in y per x, and in y
    slope_u, intercept_u, covariance : standard uncertainties and covariance, the common scale of
        the reference included
    residuals : (n,) y minus the line
    residual : their standard deviation, with ``dof`` degrees of freedom
    dof : n - 2
    coverage : factor by which a standard uncertainty is multiplied for 95 %
    birge : by which stated uncertainties were too small; 1 where they were not, or none were stated
    """

    slope: float
    intercept: float
    slope_u: float
    intercept_u: float
    covariance: float
    residuals: Array
    residual: float
    dof: int
    coverage: float
    birge: float = 1.0


def fit_line(x: Array, y: Array, u: Array | None = None, common: float = 0.0) -> Line:
    """The line of least squares.

    Parameters
    ----------
    x, y : (n,) points, n at least 3 and not all at one x
    u : (n,) standard uncertainty of each y; None: the scatter about the line tells it
    common : relative standard uncertainty of the reference's scale, the same for all points

    Raises
    ------
    ValueError : fewer points, or all at one x
    """
    n = x.size
    if n < 3 or np.ptp(x) == 0.0:
        raise ValueError("a line with its uncertainty needs three points at different x")
    weights = np.ones(n) if u is None else (np.min(u) / u) ** 2
    total = weights.sum()
    centre = float(weights @ x / total)
    spread = float(weights @ (x - centre) ** 2)
    mean = float(weights @ y / total)
    slope = float(weights @ ((x - centre) * (y - mean)) / spread)
    intercept = mean - slope * centre
    residuals = y - slope * x - intercept
    dof = n - 2
    squares = float(weights @ residuals**2)
    variance, birge = squares / dof, 1.0  # of a point of weight 1
    if u is not None:
        stated = float(np.min(u) ** 2)
        birge = max(1.0, math.sqrt(variance / stated))
        variance = stated * birge**2
    scale = common**2
    return Line(
        slope=slope, intercept=intercept,
        slope_u=math.sqrt(variance / spread + scale * slope**2),
        intercept_u=math.sqrt(
            variance * (1.0 / total + centre**2 / spread) + scale * intercept**2
        ),
        covariance=-variance * centre / spread + scale * slope * intercept,
        residuals=residuals,
        residual=math.sqrt(float(residuals @ residuals) / dof),
        dof=dof,
        # Stated uncertainties that hold are known as well as whoever stated them knew.
        coverage=student(0.975, dof) if u is None or birge > 1.0 else student(0.975, math.inf),
        birge=birge,
    )


def student(probability: float, dof: float) -> float:
    """The quantile of Student's t distribution."""
    from scipy.special import ndtri, stdtrit

    return float(ndtri(probability) if math.isinf(dof) else stdtrit(dof, probability))


@dataclass(frozen=True)
class Outlier:
    """The point that lies farthest from the line through the others.

    ``p_value`` is corrected for the choice of the worst of n; ``rest`` the sum of squares that the
    others leave.
    """

    index: int
    distance: float
    p_value: float
    rest: float


def worst_point(x: Array, y: Array, u: Array | None = None) -> Outlier | None:
    """The point with the largest externally studentised residual; None under five points.

    Source: R. D. Cook and S. Weisberg, Residuals and Influence in Regression (1982), section 2.2.
    """
    from scipy.special import stdtr

    n = x.size
    if n < 5:
        return None
    weights = np.ones(n) if u is None else 1.0 / u**2
    best: Outlier | None = None
    for i in range(n):
        keep = np.arange(n) != i
        if np.ptp(x[keep]) == 0.0:
            continue
        line = fit_line(x[keep], y[keep], None if u is None else u[keep])
        rest = float(weights[keep] @ line.residuals**2)
        w, xs = weights[keep], x[keep]
        centre = float(w @ xs / w.sum())
        spread = float(w @ (xs - centre) ** 2)
        leverage = 1.0 / w.sum() + (x[i] - centre) ** 2 / spread
        distance = float(y[i] - line.slope * x[i] - line.intercept)
        variance = rest / (n - 3) * (1.0 / weights[i] + leverage)
        t = abs(distance) / math.sqrt(variance) if variance > 0 else math.inf * (distance != 0)
        p_value = min(1.0, n * 2.0 * float(stdtr(n - 3, -t))) if t == t else 1.0
        if best is None or p_value < best.p_value or (
            p_value == best.p_value and rest < best.rest
        ):
            best = Outlier(i, distance, p_value, rest)
    return best


@dataclass(frozen=True)
class Bend:
    """What a parabola gains over the line.

    ``size`` is the largest distance of parabola and line within the points, in units of y.
    """

    size: float
    p_value: float
    rest: float


def bend(x: Array, y: Array, u: Array | None = None) -> Bend | None:
    """The F test of a quadratic term; None under five points or three different x."""
    from scipy.special import fdtrc

    n = x.size
    if n < 5 or np.unique(x).size < 3:
        return None
    weights = np.ones(n) if u is None else 1.0 / u**2
    z = (x - x.mean()) / np.ptp(x)
    root = np.sqrt(weights)
    columns = np.stack([np.ones(n), z, z**2], axis=1) * root[:, None]
    coefficients, *_ = np.linalg.lstsq(columns, y * root, rcond=None)
    rest = float(np.sum((y * root - columns @ coefficients) ** 2))
    line = fit_line(x, y, u)
    gained = float(weights @ line.residuals**2) - rest
    if rest <= 0.0:
        p_value = 0.0 if gained > 0.0 else 1.0
    else:
        p_value = float(fdtrc(1, n - 3, max(0.0, gained) / (rest / (n - 3))))
    parabola = np.stack([np.ones(n), z, z**2], axis=1) @ coefficients
    size = float(np.abs(parabola - line.slope * x - line.intercept).max())
    return Bend(size, p_value, rest)
