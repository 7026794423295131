"""Translates the config into the numbers that the kernel works with."""

from __future__ import annotations

import math

from drivers.simulated.plant import actuator
from drivers.simulated.plant.config import PlantConfig
from drivers.simulated.plant.kernel import MEMORY_AFTER_REST, Constants
from drivers.simulated.plant.strangers_kernel import pack

# Strain per volt at the beginning of a branch, to which relative slopes refer,
# is the reversible slope: no wall moves there yet.
_SPAN_V = 75.0


def constants(config: PlantConfig) -> Constants:
    """The kernel's view of the config; effects that are off have size zero."""
    e = config
    slope = e.stack.reversible
    r = actuator.thresholds()
    begin = actuator.beginning(e.stack)
    ratio = e.direction_asymmetry.ratio
    rest = e.recovery.recovery_s - e.recovery.hold_off
    remanence = e.remanence.fraction if e.remanence.on else 0.0
    return Constants(
        tau=e.amplifier_lag.tau if e.amplifier_lag.on else 0.0,
        slew=e.slew_limit.limit if e.slew_limit.on else 0.0,
        r=r,
        density=actuator.density(e.stack),
        begin=begin,
        begin_max=float(begin @ r),
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
        creep_time=actuator.CREEP_TIMES,
        creep_weight=actuator.creep_weights(e.creep),
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
        strangers=pack(e.strangers),
    )
