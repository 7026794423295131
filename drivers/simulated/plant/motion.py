"""The stack's motion in bench time: a state, advanced when asked, that can look back.

Copies of the state are kept from time to time, so that a digitizer may fetch a
record after the bench has gone on, and an event may arrive for an instant that
has been looked at already. Nothing ticks.
"""

from __future__ import annotations

import bisect

import numpy as np
from numpy.typing import NDArray

from drivers.simulated.plant import kernel, state
from drivers.simulated.plant.config import PlantConfig
from drivers.simulated.plant.constants import constants, relaxation_table, wall_table
from drivers.simulated.plant.timeline import SAME_INSTANT_S, Timeline

Array = NDArray[np.float64]

START_S = -1.0
REMEMBERED_S = 900.0
APART_S = 0.25


class Motion:
    """Drive and displacement of one stack along a timeline, from 75 V at rest on."""

    def __init__(self, config: PlantConfig, timeline: Timeline) -> None:
        self._constants = constants(config)
        self._walls = wall_table(config)
        self._relax = relaxation_table(config)
        self._timeline = timeline
        self._s, self._w, self._q, self._memo = state.new_state(self._walls, self._relax)
        self._s[state.TIME] = START_S
        at_first = float(timeline.segments[0].targets[0])
        kernel.settle(self._constants, self._walls, self._s, self._w, self._q, at_first)
        self._kept: list[tuple[Array, Array, Array]] = []
        self._kept_at: list[float] = []

    @property
    def time(self) -> float:
        return float(self._s[state.TIME])

    @property
    def oldest(self) -> float:
        """The earliest instant that can still be asked for."""
        return self._kept_at[0] if self._kept_at else self.time

    def sample(self, times: Array) -> tuple[Array, Array]:
        """Drive in V and displacement in um at ascending instants (n,).

        Raises
        ------
        ValueError : the first lies before ``oldest``.
        """
        volts, um = np.empty(times.size), np.empty(times.size)
        if not times.size:
            return volts, um
        self.go_back(float(times[0]))
        self._keep()
        done = 0
        while done < times.size:
            segment, until = self._timeline.at(self.time)
            done += kernel.march(
                self._constants,
                self._walls,
                self._relax,
                self._s,
                self._w,
                self._q,
                self._memo,
                segment.origin,
                segment.rate,
                segment.targets,
                segment.index(self.time),
                until,
                times[done:],
                volts[done:],
                um[done:],
            )
        return volts, um

    def go_back(self, t: float) -> None:
        """Make sure that the state is not later than t."""
        if self.time <= t + SAME_INSTANT_S:
            return
        i = bisect.bisect_right(self._kept_at, t + SAME_INSTANT_S) - 1
        if i < 0:
            raise ValueError(
                f"bench time {t:.6f} s is no longer known; the oldest is {self.oldest:.6f} s"
            )
        self._s, self._w, self._q = (part.copy() for part in self._kept[i])
        del self._kept[i + 1 :], self._kept_at[i + 1 :]

    def _keep(self) -> None:
        if self._kept_at and self.time < self._kept_at[-1] + APART_S:
            return
        self._kept.append((self._s.copy(), self._w.copy(), self._q.copy()))
        self._kept_at.append(self.time)
        old = bisect.bisect_left(self._kept_at, self.time - REMEMBERED_S)
        if old > 1:
            del self._kept[: old - 1], self._kept_at[: old - 1]
