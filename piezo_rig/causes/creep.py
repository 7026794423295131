"""Creep: after a change of drive the displacement goes on, logarithmically in time.

Physics: domain walls relax over barriers of very different heights, so that the strain after a
step grows by the same amount in every decade of time. H. Jung and D.-G. Gweon, Rev. Sci. Instrum.
71 (2000) 1896; Kuhnen and Janocha's operator form, Control and Intelligent Systems 29 (2001):
first-order relaxations with time constants spread evenly over the decades, here two per decade
from 10 ms to 1000 s, each driven by the displacement.

Shows as: holds that are not flat, later cycles that ride up after the first, loops that open at
low frequency. With conditions in ascending order it looks much like thermal drift.

Plausible: 1-2 % of the displacement change per decade.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import Cause, Context, FloatArray
from piezo_rig.chain.branches import Branches
from piezo_rig.chain.increments import Increment, Operation
from piezo_rig.chain.stage import Signal, Stage

TIMES_S = np.logspace(-2.0, 3.0, 11)
PER_DECADE = 2.0


def _weights() -> np.ndarray:
    weights = np.full(TIMES_S.size, 1.0 / PER_DECADE)
    weights[[0, -1]] *= 0.5
    return weights


class Creep(Cause):
    """``rate_per_decade`` of the displacement change."""

    id = "creep"
    place = "actuator"
    law: ClassVar[tuple[tuple[str, ...], float]] = (("time_since_turn",), 0.01)
    units: ClassVar[Mapping[str, str]] = {"rate_per_decade": "1"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"rate_per_decade": (0.0, 0.3)}

    def act(self, signal: Signal) -> Signal:
        from piezo_rig.chain.relaxation import relaxed

        x = np.ascontiguousarray(signal.displacement_um)
        time = np.ascontiguousarray(signal.time_s)
        crept = relaxed(time, x, TIMES_S, self["rate_per_decade"] * _weights())
        return signal.with_(displacement_um=x + crept)

    def carry(self, signal: Signal, changes: FloatArray) -> FloatArray:
        from piezo_rig.chain.relaxation import relaxed_rows

        time = np.ascontiguousarray(signal.time_s)
        weights = self["rate_per_decade"] * _weights()
        return changes + relaxed_rows(time, np.ascontiguousarray(changes), TIMES_S, weights)

    def increment(self, branches: Branches) -> Increment | str:
        weights = self["rate_per_decade"] * _weights()
        return Increment(Operation.RELAX, (float(TIMES_S.size), *TIMES_S, *weights))

    @classmethod
    def trials(cls, context: Context) -> list[Stage]:
        return [cls.of(None, rate_per_decade=0.002)]
