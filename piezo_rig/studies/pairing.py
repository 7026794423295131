"""First springs against input range and local extremum: as Appendix H pairs them, and rightly.

Appendix H works on one staircase recording. Its list of sections is: the first rise; ascending
half loops 0-5 .. 0-75 V; ascending from 70, 65 .. 5 V to 75 V; descending from 5 .. 75 V to 0;
descending from 75 V to 70 .. 5 V: 59 sections. For the slopes it skips sections 1, 2, 17, 31
and 46 (the first rise and the ranges of 5 V), which leaves 54. For the first springs it forgets
to skip, and pairs the springs of sections 1..54 with the voltages of the 54 that were left.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

SKIPPED = (0, 1, 16, 30, 45)  # of the 59, counted from 0
KEPT = 54


@dataclass(frozen=True)
class Section:
    """A half loop of the staircase: where it begins (V), its range (V), its direction."""

    start_v: float
    range_v: float
    direction: int
    first_rise: bool = False


@dataclass(frozen=True, eq=False)
class Pairs:
    """First springs with the voltages that they are held against, each of shape (m,)."""

    k1: FloatArray
    range_v: FloatArray
    extremum_v: FloatArray

    @property
    def on_range(self) -> tuple[float, float, float]:
        """Slope, offset and r-squared of the line over the range."""
        return line(self.range_v, self.k1)

    @property
    def on_extremum(self) -> tuple[float, float, float]:
        """Slope, offset and r-squared of the line over the local extremum."""
        return line(self.extremum_v, self.k1)


def sections() -> list[Section]:
    """The 59 sections in Appendix H's order."""
    steps = [float(v) for v in range(5, 80, 5)]
    below = steps[:-1]
    return [
        Section(0.0, 5.0, 1, first_rise=True),
        *(Section(0.0, v, 1) for v in steps),
        *(Section(75.0 - v, v, 1) for v in below),
        *(Section(v, v, -1) for v in steps),
        *(Section(75.0, v, -1) for v in below),
    ]


def measure(first_spring: Callable[[Section], float]) -> FloatArray:
    """First spring of every section, shape (59,)."""
    return np.array([first_spring(s) for s in sections()])


def paired_correctly(k1: FloatArray) -> Pairs:
    """Every spring with the range and the extremum of its own half loop; shape (54,)."""
    rows = [i for i in range(len(sections())) if i not in SKIPPED]
    return _pairs(k1[rows])


def paired_as_printed(k1: FloatArray) -> Pairs:
    """Springs of sections 1..54 with the voltages of the 54 sections that were not skipped."""
    return _pairs(k1[:KEPT])


def _pairs(k1: FloatArray) -> Pairs:
    kept = [s for i, s in enumerate(sections()) if i not in SKIPPED]
    return Pairs(
        k1, np.array([s.range_v for s in kept]), np.array([s.start_v for s in kept])
    )


def line(x: FloatArray, y: FloatArray) -> tuple[float, float, float]:
    """Slope, offset and r-squared of the straight line through y over x."""
    slope, offset = np.polyfit(x, y, 1)
    if np.ptp(y) == 0.0:
        return float(slope), float(offset), 0.0
    return float(slope), float(offset), float(np.corrcoef(x, y)[0, 1] ** 2)
