"""The layout of what the kernel works on: the state, the tables, the constants.

Plain arrays and named tuples, because compiled code reads them. Units: um, V, s.
Compiled code keeps a copy of these numbers, and Numba's cache watches only the
file of the function that is called: after a change here or in
``strangers_kernel.py`` also touch ``kernel.py``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Scalars of the state. TIME, drive and what it heads for:
TIME, DRIVE, TARGET = 0, 1, 2
# moved walls z, walls at the beginning of a branch e, strain that depends on excursion
WALLS, BEGIN, EXCESS = 3, 4, 5
# recent excursion, largest and smallest drive since recovery
EXCURSION, HIGHEST, LOWEST = 6, 7, 8
# turning points: direction, running extreme, drive at the last one, cycle number, aged share
DIRECTION, EXTREME, TURNED_AT, CYCLE, AGED = 9, 10, 11, 12, 13
# quasi-static displacement before relaxation; mode's place and speed; drive seen by viscosity
STATIC, MODE, MODE_SPEED, LAGGED_DRIVE = 14, 15, 16, 17
# rest: since when (s), at which drive, memory left of what it began with
REST, REST_DRIVE, MEMORY = 18, 19, 20
# strangers: parity smoothed over travel, heat, mirror behind a gap
PARITY, HEAT, MIRROR = 21, 22, 23
# walls that slide with the drive: how many, and which way
SLIDING, HEADING = 24, 25
SCALARS = 26

MEMORY_AFTER_REST = 1e-5

MEMO_SLOTS = 4

# Rows of the tables. Walls (5, n + 1): pinning strength, density, share in the
# beginning of a branch, and sums of the latter two over all weaker walls.
STRENGTH, DENSITY, BEGIN_WEIGHT, DENSITY_BELOW, BEGIN_BELOW = range(5)
# Relaxations (2, n): time constant, weight.
SPAN, WEIGHT = range(2)


class Sizes(NamedTuple):
    """Settings as the kernel reads them; a stranger that is off has size zero."""

    present: bool
    stiction: float
    place: float
    width: float
    period_two: float
    bend: float
    beyond: float
    gap: float
    heat: float
    heat_tau: float


class Constants(NamedTuple):
    """What the kernel needs of the config; an effect that is off has size zero."""

    tau: float
    slew: float  # 0: unlimited
    begin_max: float
    reversible: float
    curvature: float
    initiation: float
    initiation_scale: float
    range_size: float  # um/V per V
    range_fade: float
    extremum_size: float  # um/V per V
    asymmetry: float  # um/V
    aging: float
    aging_resets: float
    viscosity: float
    viscosity_exponent: float
    frequency: float
    damping: float
    participation: float
    recovery_time: float  # time constant; 0: never
    hold_off: float
    recovery_end: float
    rest_band: float
    remanence: float
    strangers: Sizes


def new_state(walls: Array, relax: Array) -> tuple[Array, Array, Array, Array]:
    """A virgin actuator at 0 V at time 0: scalars, walls, relaxations, memo."""
    s = np.zeros(SCALARS)
    s[[CYCLE, MEMORY]] = 1.0
    s[PARITY] = 1.0
    n = relax.shape[1]
    memo = np.zeros((MEMO_SLOTS, 2 * n + 8))
    memo[:, 0] = -1.0
    return s, np.zeros(walls.shape[1] - 1), np.zeros(n), memo
