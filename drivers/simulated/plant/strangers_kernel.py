"""Equations of the effects that no catalogue lists (settings: ``strangers.py``).

Each is continuous in the drive and, self-heating apart, independent of time.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from drivers.simulated.plant.strangers import Strangers

# Indices into Constants.strangers.
ANY, STICTION, PLACE, WIDTH, PERIOD_TWO, BEND, BEYOND, GAP, HEAT_SIZE, HEAT_TAU = range(10)
# Indices into the state; kernel.py names the same numbers.
_DRIVE, _BEGIN, _HIGHEST, _CYCLE, _PARITY, _HEAT, _MIRROR = 1, 4, 7, 12, 21, 22, 23

_PARITY_TRAVEL_V = 2.0
_BEND_ONSET_V = 5.0


def pack(strangers: Strangers) -> NDArray[np.float64]:
    """The array (10,) that the kernel reads; the first entry says whether any is on."""
    e = strangers
    switched = (e.stiction_bump, e.period_two, e.curvature_change, e.backlash, e.self_heating)
    return np.array(
        [
            float(any(effect.on for effect in switched)),
            e.stiction_bump.size * e.stiction_bump.on,
            e.stiction_bump.place,
            e.stiction_bump.width,
            e.period_two.size * e.period_two.on,
            e.curvature_change.size * e.curvature_change.on,
            e.curvature_change.beyond,
            e.backlash.gap * e.backlash.on,
            e.self_heating.size * e.self_heating.on,
            e.self_heating.tau,
        ]
    )


@numba.njit(cache=True)
def add_strangers(c: Any, s: Any, x: float, travel: float, dt: float) -> float:
    """Displacement with the strangers, after the drive moved by ``travel`` V in dt s."""
    p = c.strangers
    place = s[_BEGIN] / c.begin_max  # -1 .. 1: how far the branch has begun, with its direction
    stuck = p[STICTION] * math.exp(-0.5 * ((x - p[PLACE]) / p[WIDTH]) ** 2)
    y = x - stuck * place
    parity = 1.0 if int(s[_CYCLE]) % 2 == 1 else -1.0
    s[_PARITY] += (parity - s[_PARITY]) * (1.0 - math.exp(-abs(travel) / _PARITY_TRAVEL_V))
    y += 0.5 * p[PERIOD_TWO] * s[_PARITY] * (1.0 - place * place)
    onset = min(1.0, max(0.0, (s[_HIGHEST] - p[BEYOND]) / _BEND_ONSET_V))
    u = s[_DRIVE] / 75.0
    y += p[BEND] * onset * onset * (3.0 - 2.0 * onset) * 4.0 * u * (1.0 - u)
    s[_HEAT] = s[_HEAT] * math.exp(-dt / p[HEAT_TAU]) + abs(travel) / (300.0 * p[HEAT_TAU])
    y += p[HEAT_SIZE] * s[_HEAT]
    half = 0.5 * p[GAP]
    s[_MIRROR] = min(y + half, max(y - half, s[_MIRROR]))
    return s[_MIRROR]
