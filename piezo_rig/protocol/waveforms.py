"""The shapes that a sweep is made of, as samples of drive.

A sweep is a list of segments. Each segment says where it starts, where it
ends, and what its samples are; its last sample is the one before its end, so
that segments join without a repeated sample. Between segments, and from and
to rest, the drive moves at the protocol's approach slew.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Segment(Protocol):
    """One stretch of drive."""

    @property
    def start_v(self) -> float: ...

    @property
    def end_v(self) -> float: ...

    def count(self, rate: float) -> int: ...

    def samples(self, rate: float) -> FloatArray: ...


@dataclass(frozen=True)
class Cycles:
    """Whole periods between two levels.

    ``shape`` is ``triangle`` or ``sine`` (a raised cosine, so that it starts at a turning point).
    """

    shape: str
    lower_v: float
    upper_v: float
    start: str
    frequency_hz: float
    cycles: int

    @property
    def start_v(self) -> float:
        return self.lower_v if self.start == "lower" else self.upper_v

    @property
    def end_v(self) -> float:
        return self.start_v

    def count(self, rate: float) -> int:
        return round(self.cycles * rate / self.frequency_hz)

    def samples(self, rate: float) -> FloatArray:
        k = np.arange(self.count(rate), dtype=float)
        # Multiply before dividing: whole periods then fall on whole numbers exactly.
        phase = np.mod(k * self.frequency_hz / rate, 1.0)
        if self.shape == "triangle":
            rise = 1.0 - np.abs(2.0 * phase - 1.0)
        else:
            rise = 0.5 - 0.5 * np.cos(2.0 * math.pi * phase)
        if self.start == "upper":
            rise = 1.0 - rise
        return self.lower_v + (self.upper_v - self.lower_v) * rise


@dataclass(frozen=True)
class Hold:
    """A constant level."""

    level_v: float
    duration_s: float

    @property
    def start_v(self) -> float:
        return self.level_v

    @property
    def end_v(self) -> float:
        return self.level_v

    def count(self, rate: float) -> int:
        return round(self.duration_s * rate)

    def samples(self, rate: float) -> FloatArray:
        return np.full(self.count(rate), self.level_v)


@dataclass(frozen=True)
class Route:
    """Straight lines through a list of levels; every level is hit by a sample."""

    levels_v: tuple[float, ...]
    slew_v_per_s: float

    @property
    def start_v(self) -> float:
        return self.levels_v[0]

    @property
    def end_v(self) -> float:
        return self.levels_v[-1]

    def _legs(self, rate: float) -> list[int]:
        # A hair is taken off before rounding up, so that 0.25 s is 1250 samples, not 1251.
        return [
            max(1, math.ceil(abs(b - a) / self.slew_v_per_s * rate - 1e-9))
            for a, b in zip(self.levels_v, self.levels_v[1:], strict=False)
            if a != b
        ]

    def count(self, rate: float) -> int:
        return sum(self._legs(rate))

    def samples(self, rate: float) -> FloatArray:
        levels = [v for i, v in enumerate(self.levels_v) if i == 0 or v != self.levels_v[i - 1]]
        parts = [
            a + (b - a) * np.arange(n) / n
            for a, b, n in zip(levels, levels[1:], self._legs(rate), strict=False)
        ]
        return np.concatenate(parts) if parts else np.empty(0)


def sweep_segments(
    segments: Sequence[Segment], rest_v: float, approach_slew_v_per_s: float
) -> list[Segment]:
    """The segments with the ramps between them: from rest, through all, back to rest."""
    chain: list[Segment] = []
    level = rest_v
    for segment in segments:
        if segment.start_v != level:
            chain.append(Route((level, segment.start_v), approach_slew_v_per_s))
        chain.append(segment)
        level = segment.end_v
    if level != rest_v:
        chain.append(Route((level, rest_v), approach_slew_v_per_s))
    return chain


def sample(segments: Sequence[Segment], rate: float, rest_v: float) -> FloatArray:
    """All samples of a sweep, filled up with rest to a multiple of four (the digitizer's grid)."""
    drive = np.concatenate([s.samples(rate) for s in segments]) if segments else np.empty(0)
    missing = -drive.size % 4
    return np.concatenate([drive, np.full(missing, rest_v)]) if missing else drive


def count(segments: Sequence[Segment], rate: float) -> int:
    """How many samples ``sample`` gives, without making them."""
    total = sum(s.count(rate) for s in segments)
    return total + -total % 4
