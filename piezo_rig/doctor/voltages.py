"""Two voltages held and the upper rail touched: drive monitor and sensor follow."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from piezo_rig.bench import Bench, Recorded
from piezo_rig.config import Rig
from piezo_rig.config.toml_text import Document
from piezo_rig.doctor.check import Check
from piezo_rig.protocol import Plan, build_plan
from piezo_rig.protocol.protocol_file import parse_protocol

MONITOR_TOLERANCE_V = 0.4
TRAVEL_FACTORS = (0.4, 1.5)  # of what the config says the stack moves per volt
HOLD_S = 0.25
_RATES = (5000.0, 2000.0, 1000.0, 10_000.0)


def levels(rig: Rig) -> tuple[float, float, float]:
    """Two safe voltages and the upper rail, as far as the command may go, volts of drive."""
    top = rig.top_drive_v
    return round(top / 3, 1), round(2 * top / 3, 1), top


def steps(rig: Rig) -> Plan:
    """Steps to the two voltages and the rail, checked against the limits as any protocol is."""
    stack, limits = rig.actuator, rig.limits
    slew = min(
        limits.rest_slew_v_per_s, 0.5 * limits.slew_v_per_s,
        0.5 * limits.current_a / (stack.capacitance_f * stack.large_signal_factor),
    )
    from drivers.digitizer import rate_on_grid

    rate = next((r for r in _RATES if rate_on_grid(r * rig.digitizer.oversampling)), _RATES[0])
    low, high, top = levels(rig)
    text = (
        f'schema = "piezo-rig/protocol/1"\nsample_rate = {rate:g}\n'
        f"approach_slew_v_per_s = {slew:.6g}\n"
        f'[[condition]]\nname = "doctor"\nwaveform = "steps"\n'
        f"levels_v = [{low:g}, {high:g}, {top:g}]\nhold_s = {HOLD_S:g}\n"
    )
    return build_plan(parse_protocol(Document(text, "doctor", "doctor")), rig)


def voltages(bench: Bench, plan: Plan, seen: Recorded) -> Iterator[Check]:
    """Drive monitor and sensor at rest, at the two voltages and at the rail."""
    rig = bench.rig
    places = _holds(plan, rig.digitizer.oversampling)
    asked = np.array([round(rig.rest_drive_v, 2), *levels(rig)])
    if rig.way_to_the_top:
        yield Check(
            "note", "waveform_dac", f"command_max_v = {rig.command_max_v:g} ends the drive at "
            f"{rig.top_drive_v:g} V; drive_max_v is {rig.limits.drive_max_v:g} V",
            f"that is what the calibration {rig.amplifier_calibration.path} makes of it",
            rig.way_to_the_top,
        )
    if seen.monitor_v is None:
        yield Check("skip", "amplifier", "the drive monitor is not wired (monitor_channel = 0): "
                    "nobody can see what the stack gets")
    else:
        got = np.array([float(np.median(seen.monitor_v[p])) for p in places])
        yield _monitor_agrees(rig, asked[1:3], got[1:3])
        yield from _rails(bench, asked, got, seen)
    yield from _sensor_moves(bench, seen, places, asked)


def _holds(plan: Plan, factor: int) -> list[slice]:
    """Where the record stands still: at rest before it, then the last half of every hold."""
    drive = plan.sweeps[0].wave.drive_v
    found = [slice(0, max(1, 2 * factor))]
    half = int(0.5 * HOLD_S * plan.sample_rate)
    for level in levels(plan.rig):
        at = np.flatnonzero(np.abs(drive - level) < 0.02)
        gaps = np.flatnonzero(np.diff(at) > 1)
        end = int(at[gaps[0]] if gaps.size else at[-1])  # the way back passes the level again
        found.append(slice((end - half) * factor, end * factor))
    return found


def _monitor_agrees(
    rig: Rig, asked: NDArray[np.float64], got: NDArray[np.float64]
) -> Check:
    calibration = rig.amplifier_calibration
    stated = [u for u in (calibration.gain_u * 10, calibration.offset_u_v) if math.isfinite(u)]
    tolerance = MONITOR_TOLERANCE_V + 2 * math.hypot(*stated) if stated else MONITOR_TOLERANCE_V
    pairs = ", ".join(f"{g:.2f} V at {a:g} V" for a, g in zip(asked, got, strict=True))
    if (np.abs(got - asked) <= tolerance).all():
        return Check("ok", "amplifier", f"the drive monitor agrees: {pairs}")
    ratio = float((got[1] - got[0]) / (asked[1] - asked[0]))
    offset = float(got[0] - ratio * asked[0])
    if abs(ratio) < 0.05:
        cause = ("the monitor does not follow: its cable is off or in another channel, the "
                 "generator's cable is off, or the amplifier is switched off")
        remedy = ("check the cables from generator to amplifier and from the stack to channel "
                  f"{rig.digitizer.monitor_channel} of the digitizer")
    else:
        cause = (f"the gain is {ratio * rig.gain:.3f} where the calibration says {rig.gain:g}, the "
                 f"offset {ratio * rig.offset_v + offset:.2f} V where it says {rig.offset_v:g} V, "
                 "or the monitor's divider is not what it was")
        remedy = "measure gain and offset with a voltmeter ('piezo-rig calibrate'), set the offset"
    return Check("FAULT", "amplifier", f"the drive monitor disagrees: {pairs}", cause, remedy)


def _rails(
    bench: Bench, asked: NDArray[np.float64], got: NDArray[np.float64], seen: Recorded
) -> Iterator[Check]:
    """Whether the way to a rail goes on as between the two voltages."""
    ratio = float((got[2] - got[1]) / (asked[2] - asked[1]))
    over = bench.digitizer.overflows.get(bench.rig.digitizer.monitor_channel, 0)
    if over:
        yield Check(
            "FAULT", "digitizer", f"{over} samples of the drive monitor are beyond its range",
            f"monitor_range_v = {bench.rig.digitizer.monitor_range_v:g} is too small",
            "set the next larger range in the rig's config",
        )
        return
    saturated = False
    for name, index in (("lower", 0), ("upper", 3)):
        due = got[1] + ratio * (asked[index] - asked[1])
        short = (due - got[index]) if index else (got[index] - due)
        if short > MONITOR_TOLERANCE_V:
            saturated = True
            yield Check(
                "FAULT", "amplifier", f"saturates at the {name} rail: {got[index]:.2f} V where "
                f"{due:.2f} V are due for {asked[index]:g} V",
                "its output limit switch or its supply is set too low" if index else
                "its set voltage is higher than the generator can take back",
                "set the limit (vlimit) as the config's drive_max_v, or lower drive_max_v"
                if index else "set the set voltage as the calibration's offset_v",
            )
    if not saturated and abs(ratio) >= 0.05:
        yield Check("ok", "amplifier", f"no saturation at the rails: {got[0]:.2f} V at rest, "
                    f"{got[3]:.2f} V at {asked[3]:g} V")


def _sensor_moves(
    bench: Bench, seen: Recorded, places: list[slice], asked: NDArray[np.float64]
) -> Iterator[Check]:
    rig = bench.rig
    over = bench.digitizer.overflows.get(rig.digitizer.sensor_channel, 0)
    limit_v = min(rig.interferometer_calibration.output_limit_v, rig.digitizer.sensor_range_v)
    if over or np.abs(seen.sensor_v).max() > 0.999 * limit_v:
        yield Check(
            "FAULT", "interferometer", f"its output reaches {np.abs(seen.sensor_v).max():.3g} V, "
            f"the end of its range ({limit_v:g} V)",
            "its zero is far off, or the range is too small for the travel",
            "set its zero at rest, or take a larger sensor_range_v or the next sensitivity",
        )
        return
    volts = [float(np.median(seen.sensor_v[p])) for p in places]
    moved = rig.polarity * (volts[3] - volts[0]) * rig.sensitivity_um_per_v
    per_volt = moved / (asked[3] - asked[0])
    usual = rig.actuator.travel_um_per_v
    said = f"the stack moves {moved:.2f} um for {asked[3]:g} V"
    low, high = (factor * usual for factor in TRAVEL_FACTORS)
    if low <= per_volt <= high:
        yield Check("ok", "interferometer", said)
        return
    if abs(per_volt) < 0.02 * usual:
        cause = "the beam is lost, the sensor's cable is off, or the stack does not get the drive"
        remedy = "adjust the beam, check the cables of sensor and stack"
    elif per_volt < 0:
        cause = "the polarity in the config is not that of the sensor's mounting"
        remedy = f"set polarity = {-rig.polarity} in the rig's config"
    else:
        cause = (f"{per_volt:.3g} um per volt where the config expects up to {usual:g}: the "
                 f"sensitivity switch is not at {rig.sensitivity_switch}, the mirror is loose, or "
                 "travel_um_per_v is not this stack's")
        remedy = f"set the switch to {rig.sensitivity_switch}, check the mounting and the config"
    yield Check("FAULT", "interferometer", said, cause, remedy)
