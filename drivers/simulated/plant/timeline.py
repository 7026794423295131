"""What the generator and the amplifier's set voltage have been told, in bench time.

A timeline is a row of segments; each holds until the next begins. Before the
first the generator is off, which is 0 V of command. Units: V, s.
"""

from __future__ import annotations

import bisect
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SAME_INSTANT_S = 1e-9


@dataclass(frozen=True)
class Segment:
    """Drive targets from ``start`` on; target k holds from origin + k / rate on."""

    start: float
    origin: float
    rate: float
    command: Array
    targets: Array

    @property
    def end_of_change(self) -> float:
        """When the last target is reached for."""
        return self.origin + (self.targets.size - 1) / self.rate

    def index(self, t: float) -> int:
        """Number of the target that holds at t."""
        k = int(np.floor((t - self.origin + SAME_INSTANT_S) * self.rate))
        return min(max(k, 0), self.targets.size - 1)


class Timeline:
    """The segments in order. ``target`` turns (command, offset) into volts."""

    def __init__(self, target: Callable[[Array, float], Array], offset: float) -> None:
        self._target = target
        self._offset = offset
        off = np.zeros(1)
        self.segments = [Segment(-np.inf, 0.0, 1.0, off, target(off, offset))]
        self._starts = [-np.inf]

    @property
    def latest(self) -> float:
        """Bench time of the last event."""
        return self._starts[-1]

    def set_level(self, t: float, command: float) -> None:
        self._append(t, t, 1.0, np.array([command], dtype=np.float64))

    def play(self, t: float, command: Array, rate: float, holds_last: bool = False) -> None:
        ends_with = command[-1 if holds_last else 0]
        self._append(t, t, rate, np.append(command, ends_with))

    def set_offset(self, t: float, offset: float) -> None:
        self._offset = offset
        playing = self.segments[-1]
        self._append(t, playing.origin, playing.rate, playing.command)

    def _append(self, t: float, origin: float, rate: float, command: Array) -> None:
        if self._starts[-1] >= t - SAME_INSTANT_S:
            del self.segments[-1], self._starts[-1]  # it held for no time
        self.segments.append(Segment(t, origin, rate, command, self._target(command, self._offset)))
        self._starts.append(t)

    def at(self, t: float) -> tuple[Segment, float]:
        """The segment that holds at t, and when it ends (inf for the last)."""
        i = bisect.bisect_right(self._starts, t + SAME_INSTANT_S) - 1
        i = max(i, 0)
        until = self._starts[i + 1] if i + 1 < len(self._starts) else np.inf
        return self.segments[i], until

    def forget_before(self, t: float) -> None:
        """Let go of segments that ended before t."""
        keep = max(0, bisect.bisect_right(self._starts, t) - 1)
        del self.segments[:keep], self._starts[:keep]
