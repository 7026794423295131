"""Translates the config into the numbers that the kernel works with."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from drivers.simulated.plant import actuator
from drivers.simulated.plant.config import PlantConfig
from drivers.simulated.plant.state import (
    BEGIN_BELOW,
    BEGIN_WEIGHT,
    DENSITY,
    DENSITY_BELOW,
    MEMORY_AFTER_REST,
    STRENGTH,
    Constants,
)
from drivers.simulated.plant.strangers_kernel import sizes

# Strain per volt at the beginning of a branch, to which relative slopes refer,
# is the reversible slope: no wall moves there yet.
_SPAN_V = 75.0


def constants(config: PlantConfig) -> Constants:
    """The kernel's view of the config; effects that are off have size zero."""
    e = config
    slope = e.stack.reversible
    ratio = e.direction_asymmetry.ratio
    rest = e.recovery.recovery_s - e.recovery.hold_off
    remanence = e.remanence.fraction if e.remanence.on else 0.0
    return Constants(
        tau=e.amplifier_lag.tau if e.amplifier_lag.on else 0.0,
        slew=e.slew_limit.limit if e.slew_limit.on else 0.0,
        begin_max=float(actuator.beginning(e.stack) @ actuator.thresholds()),
        reversible=slope,
        curvature=e.stack.curvature,
        initiation=e.initiation_stage.size if e.initiation_stage.on else 0.0,
        initiation_scale=e.initiation_stage.scale,
        range_size=e.range_dependence.size * slope / _SPAN_V if e.range_dependence.on else 0.0,
        range_fade=e.range_dependence.fade,
        extremum_size=(
            e.extremum_dependence.size * slope / _SPAN_V if e.extremum_dependence.on else 0.0
        ),
        asymmetry=slope * (ratio - 1.0) / (ratio + 1.0) if e.direction_asymmetry.on else 0.0,
        aging=e.cycle_aging.rate_per_decade if e.cycle_aging.on else 0.0,
        aging_resets=float(e.cycle_aging.reset_at_rest),
        viscosity=e.rate_dependence.lag_um if e.rate_dependence.on else 0.0,
        viscosity_exponent=e.rate_dependence.exponent,
        frequency=e.resonance.frequency,
        damping=e.resonance.damping,
        participation=e.resonance.participation if e.resonance.on else 0.0,
        recovery_time=rest / -math.log(MEMORY_AFTER_REST) if e.recovery.on else 0.0,
        hold_off=e.recovery.hold_off,
        recovery_end=2.0 * e.recovery.recovery_s,
        rest_band=e.recovery.band,
        remanence=remanence,
        strangers=sizes(e.strangers),
    )


def wall_table(config: PlantConfig) -> NDArray[np.float64]:
    """The walls (5, n + 1), rows as in kernel.py; the last column only ends the sums."""
    r = actuator.thresholds()
    density = actuator.density(config.stack)
    begin = actuator.beginning(config.stack)
    table = np.zeros((5, r.size + 1))
    table[STRENGTH, :-1] = r
    table[DENSITY, :-1] = density
    table[BEGIN_WEIGHT, :-1] = begin
    table[DENSITY_BELOW, 1:] = np.cumsum(density)
    table[BEGIN_BELOW, 1:] = np.cumsum(begin)
    return table


def relaxation_table(config: PlantConfig) -> NDArray[np.float64]:
    """The relaxations (2, n), rows as in kernel.py."""
    return np.stack([actuator.CREEP_TIMES, actuator.creep_weights(config.creep)])
