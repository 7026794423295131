"""Equations of the effects that no catalogue lists (settings: ``strangers.py``).

Each is continuous in the drive and, self-heating apart, independent of time.
"""

from __future__ import annotations

import math
from typing import Any

import numba

from drivers.simulated.plant.state import (
    BEGIN,
    CYCLE,
    DRIVE,
    HEAT,
    HIGHEST,
    MIRROR,
    PARITY,
    Sizes,
)
from drivers.simulated.plant.strangers import Strangers

_PARITY_TRAVEL_V = 2.0
_BEND_ONSET_V = 5.0


def sizes(strangers: Strangers) -> Sizes:
    """The kernel's view of the settings."""
    e = strangers
    switched = (e.stiction_bump, e.period_two, e.curvature_change, e.backlash, e.self_heating)
    return Sizes(
        present=any(effect.on for effect in switched),
        stiction=e.stiction_bump.size * e.stiction_bump.on,
        place=e.stiction_bump.place,
        width=e.stiction_bump.width,
        period_two=e.period_two.size * e.period_two.on,
        bend=e.curvature_change.size * e.curvature_change.on,
        beyond=e.curvature_change.beyond,
        gap=e.backlash.gap * e.backlash.on,
        heat=e.self_heating.size * e.self_heating.on,
        heat_tau=e.self_heating.tau,
    )


@numba.njit(cache=True)
def add_strangers(c: Any, s: Any, x: float, travel: float, dt: float) -> float:
    """Displacement with the strangers, after the drive moved by ``travel`` V in dt s."""
    p = c.strangers
    place = s[BEGIN] / c.begin_max  # -1 .. 1: how far the branch has begun, with its direction
    stuck = p.stiction * math.exp(-0.5 * ((x - p.place) / p.width) ** 2)
    y = x - stuck * place
    parity = 1.0 if int(s[CYCLE]) % 2 == 1 else -1.0
    s[PARITY] += (parity - s[PARITY]) * (1.0 - math.exp(-abs(travel) / _PARITY_TRAVEL_V))
    y += 0.5 * p.period_two * s[PARITY] * (1.0 - place * place)
    onset = min(1.0, max(0.0, (s[HIGHEST] - p.beyond) / _BEND_ONSET_V))
    u = s[DRIVE] / 75.0
    y += p.bend * onset * onset * (3.0 - 2.0 * onset) * 4.0 * u * (1.0 - u)
    s[HEAT] = s[HEAT] * math.exp(-dt / p.heat_tau) + abs(travel) / (300.0 * p.heat_tau)
    y += p.heat * s[HEAT]
    half = 0.5 * p.gap
    s[MIRROR] = min(y + half, max(y - half, s[MIRROR]))
    return s[MIRROR]
