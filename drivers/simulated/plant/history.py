"""The plant's own record of the voltage on the stack.

Independent of what any instrument measures, and written as it is made, so a
long session costs no memory. Rows are 1 ms apart while the drive changes, at
every event, and at both ends of a constant stretch.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from drivers.simulated.plant.motion import START_S, Motion
from drivers.simulated.plant.timeline import SAME_INSTANT_S, Segment, Timeline

Array = NDArray[np.float64]
Sink = Callable[[Array, Array], None]

STEP_S = 1e-3
_BLOCK = 65536


def csv_sink(file: TextIO) -> Sink:
    """A sink that writes ``time_s,stack_v`` rows, header first."""
    file.write("time_s,stack_v\n")

    def write(time_s: Array, stack_v: Array) -> None:
        rows = zip(time_s.tolist(), stack_v.tolist(), strict=True)
        file.write("".join(f"{t:.6f},{v:.6f}\n" for t, v in rows))
        file.flush()

    return write


class History:
    """Follows the timeline behind the events and hands rows (time_s, stack_v) to a sink."""

    def __init__(self, motion: Motion, timeline: Timeline, settling_s: float, sink: Sink) -> None:
        self._motion = motion
        self._timeline = timeline
        self._settling = settling_s
        self._sink = sink
        self._written = START_S
        self._last: tuple[float, float] | None = None  # the newest row, not yet written
        self._repeated = False  # it equals the row before it

    @property
    def oldest(self) -> float:
        return self._motion.oldest

    def write_until(self, t: float) -> None:
        """Write everything up to t; what happens before t must be known by now."""
        while self._written < t - SAME_INSTANT_S:
            segment, until = self._timeline.at(self._written)
            end = min(t, until)
            self._write_segment(segment, end)
            self._written = end

    def close(self, t: float) -> None:
        """Write up to t, and the last row of a constant stretch."""
        self.write_until(t)
        if self._last is not None:
            self._sink(*(np.array([value]) for value in self._last))
            self._last = None

    def _write_segment(self, segment: Segment, end: float) -> None:
        begin = self._written
        changing = min(end, max(begin, segment.end_of_change) + self._settling)
        count = int(np.ceil((changing - begin) / STEP_S - 1e-6))
        for first in range(1, count + 1, _BLOCK):
            k = np.arange(first, min(first + _BLOCK, count + 1))
            self._write(np.minimum(begin + k * STEP_S, changing))
        if end > changing + SAME_INSTANT_S:
            self._write(np.array([end]))

    def _write(self, times: Array) -> None:
        volts, _ = self._motion.sample(times)
        if self._last is not None:
            times = np.concatenate([[self._last[0]], times])
            volts = np.concatenate([[self._last[1]], volts])
        # The newest row waits: it is needed only if what follows differs.
        same = np.abs(np.diff(volts)) < 1e-9
        inside = np.zeros(volts.size, dtype=bool)
        inside[1:-1] = same[:-1] & same[1:]
        inside[-1] = True
        if self._last is not None and self._repeated and same.size and same[0]:
            inside[0] = True
        self._repeated = bool(same[-1]) if same.size else False
        self._last = (float(times[-1]), float(volts[-1]))
        if not inside.all():
            self._sink(times[~inside], volts[~inside])
