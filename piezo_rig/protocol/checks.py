"""Checks a plan's samples against the rig's limits, before any of them leaves the program.

Both rails are reached exactly by design, so every level has half an LSB of
tolerance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from piezo_rig.errors import LimitError
from piezo_rig.protocol.plan import (
    DAC_FULL_SCALE,
    DIGITIZER_MAX_SAMPLES,
    Plan,
    Wave,
)
from piezo_rig.protocol.protocol_file import Condition

CARD_LSB_V = 20.0 / 65_536
"""Of an NI card, whose 16 bit are those of +-10 V whatever it plays."""


@dataclass(frozen=True)
class Extremes:
    """What the plan asks for at its worst, in the units of the limits."""

    drive_min_v: float
    drive_max_v: float
    slew_v_per_s: float
    current_a: float
    dac_lsb_v: float
    travel_um: float
    sensor_v: float


def check_plan(plan: Plan) -> None:
    """Refuse a plan that would break a limit.

    Raises
    ------
    LimitError : names condition, sample, value and limit
    """
    _check_rates(plan)
    for condition, wave in plan.conditions():
        _check_levels(plan, condition, wave)
        _check_slew(plan, condition, wave)
    _check_sensor(plan)
    _check_monitor(plan)


def extremes(plan: Plan) -> Extremes:
    """The worst values over all conditions."""
    waves = [wave for _, wave in plan.conditions()]
    low = min(float(w.drive_v.min()) for w in waves)
    high = max(float(w.drive_v.max()) for w in waves)
    slew = max(float(_slew(w, plan.sample_rate, plan.rig.rest_drive_v).max()) for w in waves)
    stack = plan.rig.actuator
    travel = (high - low) * stack.travel_um_per_v
    return Extremes(
        drive_min_v=low, drive_max_v=high, slew_v_per_s=slew,
        current_a=slew * stack.capacitance_f * stack.large_signal_factor,
        dac_lsb_v=plan.rig.gain * (CARD_LSB_V if plan.rig.is_card else max(map(_lsb_v, waves))),
        travel_um=travel, sensor_v=travel / plan.rig.sensitivity_um_per_v,
    )


def _lsb_v(wave: Wave) -> float:
    """Volts of command per DAC step."""
    return (wave.high_v - wave.low_v) / (2 * DAC_FULL_SCALE)


def _slew(wave: Wave, rate: float, rest_v: float) -> np.ndarray:
    """|dV/dt| of the drive from sample to sample, with the way from and back to rest."""
    closed = np.concatenate([[rest_v], wave.drive_v, [rest_v]])
    return np.abs(np.diff(closed)) * rate


def _check_rates(plan: Plan) -> None:
    rate = plan.sample_rate * plan.rig.digitizer.oversampling
    exponent = math.floor(math.log10(rate) + 1e-12)
    leading = rate / 10**exponent
    if not (1e3 <= rate <= 20e6) or min(abs(leading - m) for m in (1, 2, 5)) > 1e-9:
        line = f":{plan.protocol.rate_line}" if plan.protocol.rate_line else ""
        raise LimitError(
            "limit-rate",
            f"{plan.protocol.path}{line}: the digitizer cannot sample at {rate:g} Sa/s",
            "its grid is 1, 2 or 5 times a power of ten, from 1 kSa/s to 20 MSa/s",
            "change sample_rate in the protocol or oversampling in the rig's config",
        )
    longest = max(plan.sweeps, key=lambda s: s.samples)
    if longest.samples * plan.rig.digitizer.oversampling > DIGITIZER_MAX_SAMPLES:
        raise LimitError(
            "limit-record",
            f"condition {longest.condition.name}: {longest.samples} samples at "
            f"{plan.rig.digitizer.oversampling} x oversampling exceed the digitizer's record",
            "the sweep is too long", "use fewer cycles or less oversampling",
        )


def _where(plan: Plan, condition: Condition, index: int) -> str:
    place = f"{plan.protocol.path}:{condition.line}: " if condition.line else ""
    return f"{place}condition {condition.name}, sample {index} ({index / plan.sample_rate:.4f} s)"


def _check_levels(plan: Plan, condition: Condition, wave: Wave) -> None:
    rig, limits = plan.rig, plan.rig.limits
    half = 0.5 * _lsb_v(wave)
    drive_half = half * rig.gain
    for values, low, high, tolerance, word, code, unit in (
        (wave.drive_v, limits.drive_min_v, limits.drive_max_v, drive_half, "drive",
         "limit-drive", "V on the stack"),
        (wave.command_v, rig.command_min_v, rig.command_max_v, half, "command",
         "limit-command", "V"),
    ):
        index = int(values.argmax())
        if values[index] <= high + tolerance:
            index = int(values.argmin())
            if values[index] >= low - tolerance:
                continue
        cause = "the protocol asks for more than this rig may give"
        remedy = "change the condition's levels, or the rig's config if its limits are wrong"
        if code == "limit-command" and values[index] > high and rig.way_to_the_top:
            cause = (f"by the calibration {rig.amplifier_calibration.path} that is what "
                     f"{wave.drive_v[index]:.4g} V on the stack need")
            remedy = rig.way_to_the_top
        raise LimitError(
            code,
            f"{_where(plan, condition, index)}: {word} of {values[index]:.3f} {unit} is outside "
            f"{low:g} .. {high:g} V", cause, remedy,
        )


def _check_slew(plan: Plan, condition: Condition, wave: Wave) -> None:
    limits, stack = plan.rig.limits, plan.rig.actuator
    slew = _slew(wave, plan.sample_rate, plan.rig.rest_drive_v)
    index = int(slew.argmax())
    # One DAC step more or less is rounding, not slew.
    tolerance = 1.0001 * _lsb_v(wave) * plan.rig.gain * plan.sample_rate
    if slew[index] > limits.slew_v_per_s + tolerance:
        raise LimitError(
            "limit-slew",
            f"{_where(plan, condition, index)}: the drive moves at {slew[index]:.4g} V/s; "
            f"the limit is {limits.slew_v_per_s:g} V/s",
            "a step, or a frequency or range too large", "lower the frequency or the range",
        )
    farad = stack.capacitance_f * stack.large_signal_factor
    if (slew[index] - tolerance) * farad > limits.current_a:
        raise LimitError(
            "limit-current",
            f"{_where(plan, condition, index)}: C dV/dt = {slew[index] * farad * 1e3:.3g} mA into "
            f"{farad * 1e6:.3g} uF; the amplifier gives {limits.current_a * 1e3:g} mA",
            "a step, or a frequency or range too large", "lower the frequency or the range",
        )


def _check_monitor(plan: Plan) -> None:
    setup, need = plan.rig.digitizer, extremes(plan)
    peak = max(abs(need.drive_min_v), abs(need.drive_max_v))
    if setup.monitor_channel and peak > setup.monitor_range_v:
        raise LimitError(
            "limit-monitor",
            f"{plan.rig.path}: the drive reaches {peak:.2f} V; the monitor's record saturates at "
            f"{setup.monitor_range_v:g} V",
            "the digitizer's range is too small for the drive", "set monitor_range_v = 128",
        )


def _check_sensor(plan: Plan) -> None:
    rig = plan.rig
    need = extremes(plan)
    limit = min(rig.interferometer_calibration.output_limit_v, rig.digitizer.sensor_range_v)
    if need.sensor_v > limit:
        table = rig.interferometer_calibration.sensitivities_um_per_v
        fitting = [i for i, s in enumerate(table) if need.travel_um / s <= limit]
        raise LimitError(
            "limit-sensor",
            f"sensitivity {rig.sensitivity_switch} ({rig.sensitivity_um_per_v:g} um/V) turns up to "
            f"{need.travel_um:.3g} um of travel into {need.sensor_v:.3g} V; "
            f"the record saturates at {limit:g} V",
            "the sensitivity is too high for this protocol, or the digitizer's range too small",
            f"set sensitivity = {fitting[0]}" if fitting else "raise sensor_range_v",
        )
