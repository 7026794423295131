"""The actuator: a Prandtl-Ishlinskii body whose thresholds lie on nobody's grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.studies.hidden import kernels

FloatArray = NDArray[np.float64]
FULL_V, FULL_UM = 75.0, 10.0


@dataclass(frozen=True, eq=False)
class Law:
    """What later branches begin with, beside the body's own first slope; see `kernels.branched`."""

    per_range: float = 0.0  # V/um per V of the most recent half loop
    per_extremum: float = 0.0  # V/um per V at the turning point
    ratio: float = 1.0  # first slopes, rising over falling
    bump_per_range: float = 0.0  # um/V per V
    bump_direction: float = 0.0  # um/V, rising
    reach: float = 4.0  # V


@dataclass(frozen=True, eq=False)
class Body:
    """A linear part, play operators from a virgin state, and a memoryless curvature.

    Attributes
    ----------
    compliance : um/V of the linear part
    thresholds, weights : shape (m,), V and um/V, thresholds ascending
    curvature : um, amplitudes of a half and a whole sine wave over 0-75 V
    kind : in words
    """

    compliance: float
    thresholds: FloatArray
    weights: FloatArray
    curvature: tuple[float, float]
    kind: str

    @property
    def first_break_um(self) -> float:
        """Displacement at which the first element gives way on the first rise."""
        return self.compliance * float(self.thresholds[0])

    @property
    def first_spring(self) -> float:
        """Spring constant of the first elasto-slide element, V/um."""
        return 1.0 / self.compliance - 1.0 / (self.compliance + float(self.weights[0]))

    def rise(self) -> tuple[FloatArray, FloatArray, float]:
        """The first rise: knots V, values um, slope beyond them um/V."""
        knots = np.append(0.0, self.thresholds)
        c = self.compliance + np.append(0.0, np.cumsum(self.weights))
        return knots, np.append(0.0, np.cumsum(c[:-1] * np.diff(knots))), float(c[-1])

    def bent(self, drive_v: FloatArray) -> FloatArray:
        """The memoryless part, um, shape (n,)."""
        angle = np.pi / FULL_V * drive_v
        return self.curvature[0] * np.sin(angle) + self.curvature[1] * np.sin(2.0 * angle)

    def displacement(
        self,
        drive_v: FloatArray,
        law: Law | None = None,
        rise: tuple[FloatArray, FloatArray, float] | None = None,
    ) -> FloatArray:
        """Displacement (n,) of a drive that begins at rest; ``rise`` replaces the first rise."""
        law = law or Law()
        knots, values, last = self.rise()
        out = kernels.branched(
            np.ascontiguousarray(drive_v), *(rise or (knots, values, last)),
            1.0 / self.compliance, 2.0 * values[1], 2.0 * (knots[1:] - knots[1]),
            2.0 * (values[1:] - values[1]), last, law.per_range, law.per_extremum, law.ratio,
            law.bump_per_range, law.bump_direction, law.reach,
        )  # fmt: skip
        return out + self.bent(drive_v)

    def rate_dependent(self, drive_v: FloatArray, wider_v: FloatArray) -> FloatArray:
        """With thresholds wider by ``wider_v`` (n,) at every sample."""
        moved = kernels.played_sum(
            np.ascontiguousarray(drive_v), self.thresholds, self.weights, wider_v
        )
        return moved + self.compliance * drive_v + self.bent(drive_v)


def random_body(rng: np.random.Generator, first_element: bool = False) -> Body:
    """About 10 um at 75 V with a loop of 10-15 %; 40-120 operators, or a density.

    ``first_element`` : the first elasto-slide element is a distinct one of 0.05-0.4 um, as the
    thesis's laws of the first spring need it
    """
    while True:
        dense = rng.random() < 0.3
        count = 700 if dense else int(rng.integers(40, 121))
        shape = rng.uniform(0.8, 1.3)
        thresholds = np.sort(36.0 * rng.uniform(0.0, 1.0, count) ** shape) + 0.03
        weights = rng.uniform(0.97, 1.03, count) if dense else rng.uniform(0.5, 1.5, count)
        weights *= np.exp(-rng.uniform(0.0, 1.0) * thresholds / 36.0)
        weights /= weights.sum()
        first = 0.0
        if first_element:
            r = float(np.exp(rng.uniform(np.log(0.5), np.log(4.0))))
            later = thresholds > 1.05 * r
            thresholds = np.append(r, thresholds[later])
            weights = np.append(0.0, weights[later])
            first = rng.uniform(0.03, 0.15)
        wanted, travel = rng.uniform(0.10, 0.15), FULL_UM * rng.uniform(0.9, 1.1)
        low, high = 0.0, 5.0
        for _ in range(50):
            size = 0.5 * (low + high)
            total = size * weights
            total[0] += first
            low, high = (size, high) if _width(thresholds, total) < wanted else (low, size)
        total = size * weights
        total[0] += first
        scale = travel / _later(thresholds, total, FULL_V)
        bend = (0.0, 0.0)
        if rng.random() < 0.4:
            bend = (travel * rng.uniform(-0.01, 0.01), travel * rng.uniform(-0.003, 0.003))
        kind = ("dense" if dense else "discrete") + (", curved" if bend[0] else "")
        body = Body(scale, thresholds, scale * total, bend, kind)
        if not first_element or 0.05 <= body.first_break_um <= 0.4:
            return body


def _later(thresholds: FloatArray, weights: FloatArray, v: float) -> float:
    return v + float(weights @ np.maximum(v - 2.0 * thresholds, 0.0))


def _width(thresholds: FloatArray, weights: FloatArray) -> float:
    """Loop opening over travel of a steady 0-75 V loop, of a body with unit compliance."""
    full = _later(thresholds, weights, FULL_V)
    openings = [
        full - _later(thresholds, weights, FULL_V - v) - _later(thresholds, weights, v)
        for v in np.linspace(0.3, 0.7, 9) * FULL_V
    ]
    return max(openings) / full
