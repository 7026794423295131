"""Checks a rig before the day begins, one line of a checklist after the other.

First every instrument by itself: does it answer, is it the expected one, is its error queue
empty. Then the bench as a whole: brought to rest, its settings read back, the sensor's noise at
rest, two voltages held and the upper rail touched, and back to rest, whatever happens.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.clock import Clock, RealClock, VirtualClock
from piezo_rig.bench import Bench, Recorded, instrument_errors, open_bench, simulated_instruments
from piezo_rig.config import Rig
from piezo_rig.config.toml_text import Document
from piezo_rig.errors import Aborted, PiezoRigError
from piezo_rig.guard.lock import hold
from piezo_rig.protocol import Plan, build_plan
from piezo_rig.protocol.protocol_file import parse_protocol

MONITOR_TOLERANCE_V = 0.4
NOISE_FACTORS = (0.33, 2.0)  # of what the calibration says
TRAVEL_FACTORS = (0.4, 1.5)  # of what the config says the stack moves per volt
HOLD_S = 0.25
NOISE_S = 1.0
SETTLE_S = 2.0
_ATTEMPTS = 2
_RATES = (5000.0, 2000.0, 1000.0, 10_000.0)

Confirm = Callable[[str], bool]


@dataclass(frozen=True)
class Check:
    """One line of the checklist.

    ``status`` is ``ok``, ``FAULT``, ``skip`` (could not be checked, ``text`` says why) or
    ``note``; a fault has a likely cause and what to do.
    """

    status: str
    subject: str
    text: str
    cause: str = ""
    remedy: str = ""

    @classmethod
    def of(cls, subject: str, error: PiezoRigError) -> Check:
        return cls("FAULT", subject, f"{error.what} [{error.code}]", error.cause, error.remedy)


def examine(rig: Rig, confirm: Confirm) -> Iterator[Check]:
    """All checks of a rig, in order; the stack is at rest when it ends or is closed.

    Parameters
    ----------
    rig : the config; a simulated one gets its instruments started
    confirm : asks the operator a yes-or-no question (the interferometer's switch)
    """
    alone = list(_one_by_one(rig))
    yield from alone
    if any(check.status == "FAULT" for check in alone):
        yield Check("skip", "bench", "nothing was moved, because an instrument is not in order")
        return
    yield from _together(rig, confirm)


# ------------------------------------------------------------------ each instrument by itself


def _one_by_one(rig: Rig) -> Iterator[Check]:
    if not rig.simulated:
        # Nobody else may hold the generator: a question in the midst of a run would spoil it.
        try:
            with instrument_errors():
                lock = hold(rig.waveform_dac.address)
        except PiezoRigError as error:
            yield Check.of("waveform_dac", error)
            return
        try:
            yield from _instruments(rig, RealClock())
        finally:
            if lock >= 0:
                os.close(lock)
        return
    clock: Clock = VirtualClock() if rig.clock == "virtual" else RealClock()
    try:
        with simulated_instruments(rig, clock) as wired:
            yield from _instruments(wired, clock)
    except PiezoRigError as error:
        yield Check.of("bench", error)


def _instruments(rig: Rig, clock: Clock) -> Iterator[Check]:
    from drivers.amplifier import ThorlabsMDT69x
    from drivers.digitizer import KeysightL4532A
    from drivers.waveform_dac import Keysight33500B

    yield from _instrument(
        "waveform_dac", rig.waveform_dac, lambda line: Keysight33500B(line), True
    )
    yield from _instrument(
        "digitizer", rig.digitizer.link, lambda line: KeysightL4532A(line, clock), True
    )
    if rig.amplifier.driver == "manual":
        yield Check(
            "note", "amplifier", f"has no link: see that its set voltage is {rig.offset_v:g} V and "
            f"its limit {rig.limits.drive_max_v:g} V",
        )
    else:
        yield from _instrument(
            "amplifier", rig.amplifier,
            lambda line: ThorlabsMDT69x(line, rig.offset_v, rig.limits.drive_max_v), False,
        )


def _instrument(
    name: str, link: Any, driver: Callable[[Any], Any], scpi: bool
) -> Iterator[Check]:
    """Does it answer, is its error queue empty, is it the expected one."""
    from drivers.scpi_instrument import ScpiInstrument
    from drivers.transport import open_transport

    try:
        with instrument_errors():
            line = open_transport(link.address, name, link.timeout_s)
    except PiezoRigError as error:
        yield Check.of(name, error)
        return
    try:
        if scpi:
            queue = _error_queue(name, ScpiInstrument(line))
            if queue is not None:
                yield queue
        with instrument_errors():
            identity = driver(line).connect()
    except PiezoRigError as error:
        yield Check.of(name, error)
        return
    finally:
        line.close()
    if link.serial and identity.serial != link.serial:
        yield Check(
            "FAULT", name, f"has serial number {identity.serial}, the config expects {link.serial}",
            "another instrument at this address", "mend the config or the cables",
        )
    else:
        expected = "as the config says" if link.serial else "the config asks for none in particular"
        yield Check("ok", name, f"answers as {identity.model} {identity.serial}, {expected}")


def _error_queue(name: str, link: Any) -> Check | None:
    """What stood in the error queue before anything was sent; emptied by reading."""
    with instrument_errors():
        link.query("*IDN?")
    try:
        with instrument_errors():
            link.drain_errors()
    except PiezoRigError as error:
        if error.code != "instrument-error-queue":
            raise
        return Check(
            "FAULT", name, f"its error queue is not empty: {error.what}",
            "another program or a person at the front panel sent it something wrong, or a run "
            "broke off", "the queue has been read and is empty now; run doctor again",
        )
    return Check("ok", name, "error queue is empty")


# ----------------------------------------------------------------------- the bench as a whole


def _together(rig: Rig, confirm: Confirm) -> Iterator[Check]:
    """Everything that needs the whole bench; a fault that stops it is the last check but rest."""
    try:
        with open_bench(rig, confirm) as bench:
            try:
                yield from _moved(bench)
            except PiezoRigError as error:
                yield Check.of(_subject(error), error)
            except KeyboardInterrupt:
                at_rest = _to_rest(bench)
                aborted = Aborted("aborted", "stopped by the operator", "", "run doctor again")
                aborted.piezo = at_rest.text
                raise aborted from None
            finally:
                at_rest = _to_rest(bench)
            yield at_rest
    except PiezoRigError as error:
        yield Check.of(_subject(error), error)


def _subject(error: PiezoRigError) -> str:
    """Which instrument an error is about, where its text begins with one."""
    first = error.what.partition(":")[0]
    known = ("waveform_dac", "digitizer", "amplifier", "interferometer")
    return first if first in known else "bench"


def _to_rest(bench: Bench) -> Check:
    if not bench.touched:
        return Check("note", "piezo", bench.piezo())
    for attempt in range(_ATTEMPTS):  # a line that broke is opened again by the second
        try:
            moved = bench.rest()
            break
        except PiezoRigError as error:
            if attempt == _ATTEMPTS - 1:
                return Check(
                    "FAULT", "piezo", f"{bench.piezo()}: {error.what}", error.cause,
                    "switch the amplifier off by hand, then look at the generator",
                )
    return Check("ok", "piezo", f"at rest, {abs(moved['to_v']):.2f} V on the stack as read back")


def _moved(bench: Bench) -> Iterator[Check]:
    rig = bench.rig
    yield Check("ok", "bench", f"all {bench.origin}, and all that the config names")
    moved = bench.rest()
    yield Check(
        "ok", "waveform_dac", f"found at {moved['from_v']:.1f} V on the stack, brought to rest in "
        f"{moved['duration_s']:.1f} s; level, load, burst and trigger read back as set",
    )
    plan = _plan(rig)
    bench.load("doctor", plan.sweeps[0].wave, plan.sample_rate)
    yield Check(
        "ok", "digitizer", f"takes {plan.sample_rate * rig.digitizer.oversampling:g} Sa/s, ranges "
        "and trigger; all read back as set",
    )
    yield from _noise(bench, plan.sample_rate)
    seen = bench.play("doctor", plan.sweeps[0].wave, plan.sample_rate)
    yield Check("ok", "digitizer", "the trigger from the waveform DAC arrives")
    yield from _voltages(bench, plan, seen)


def levels(rig: Rig) -> tuple[float, float, float]:
    """Two safe voltages and the upper rail, volts of drive."""
    top = rig.limits.drive_max_v
    return round(top / 3, 1), round(2 * top / 3, 1), top


def _plan(rig: Rig) -> Plan:
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


# ------------------------------------------------------------------------------- the sensor


def _noise(bench: Bench, rate: float) -> Iterator[Check]:
    """The sensor's noise at rest against its calibration."""
    rig = bench.rig
    setup, calibration = rig.digitizer, rig.interferometer_calibration
    bench.step("looking at the sensor's noise", SETTLE_S + NOISE_S)
    bench.clock.sleep(SETTLE_S)  # the stack creeps after the way to rest
    rate *= setup.oversampling
    count = int(NOISE_S * rate) // 4 * 4
    with instrument_errors():
        bench.digitizer.configure(
            rate, count, {setup.sensor_channel: setup.sensor_range_v}, trigger="IMM"
        )
        bench.digitizer.arm()
        volts = bench.digitizer.fetch([setup.sensor_channel], count)[setup.sensor_channel]
    scale = rig.sensitivity_um_per_v
    measured = 1e3 * scale * _rms_without_drift(volts)
    step_v = 2 * setup.sensor_range_v / 65_536 / math.sqrt(12)
    parts = [calibration.noise_nm, 1e3 * scale * calibration.output_noise_v, 1e3 * scale * step_v]
    if math.isnan(calibration.noise_nm):
        yield Check("note", "interferometer", f"noise at rest is {measured:.2f} nm rms; the "
                    "calibration states none (noise_nm)")
        return
    expected = math.hypot(*(0.0 if math.isnan(p) else p for p in parts))
    said = f"noise at rest is {measured:.2f} nm rms, the calibration says {expected:.2f} nm"
    low, high = (factor * expected for factor in NOISE_FACTORS)
    if np.ptp(volts) == 0:
        yield Check(
            "FAULT", "interferometer", f"its output stands still at {volts[0]:.4g} V",
            "the beam is interrupted, the output saturates, or its cable is off",
            "adjust the beam, look at the signal strength, check the cable to the digitizer",
        )
    elif measured > high:
        yield Check(
            "FAULT", "interferometer", said, _kind_of_noise(volts, rate),
            "close the hood, look at beam and grounding, wait until the room is quiet",
        )
    elif measured < low:
        yield Check(
            "FAULT", "interferometer", said,
            "the beam is interrupted, or the sensitivity switch is not where the config says",
            f"adjust the beam; set the switch to {rig.sensitivity_switch}",
        )
    else:
        yield Check("ok", "interferometer", said)


def _rms_without_drift(volts: NDArray[np.float64]) -> float:
    """Rms of what a cubic through the record leaves: creep and drift of a second are smooth."""
    x = np.linspace(-1, 1, volts.size)
    smooth = np.polynomial.polynomial.polyval(x, np.polynomial.polynomial.polyfit(x, volts, 3))
    return float(np.std(volts - smooth))


def _kind_of_noise(volts: NDArray[np.float64], rate: float) -> str:
    """What the noise looks like, as a likely cause."""
    x = volts - volts.mean()
    power = np.abs(np.fft.rfft(x * np.hanning(x.size))) ** 2
    frequency = np.fft.rfftfreq(x.size, 1 / rate)
    for mains in (50.0, 60.0):
        near = np.abs(frequency - mains) < 2.5
        if power[near].sum() > 0.3 * power[frequency > 5].sum():
            return f"mains hum at {mains:g} Hz: a ground loop, or a supply near the cable"
    deviation = np.abs(x - np.median(x))
    if deviation.max() > 12 * np.median(deviation):
        return "single spikes: the beam is interrupted for moments"
    return "air, vibration, or a weak beam"


# ------------------------------------------------------------------------------ the voltages


def _voltages(bench: Bench, plan: Plan, seen: Recorded) -> Iterator[Check]:
    """Drive monitor and sensor at rest, at the two voltages and at the rail."""
    rig = bench.rig
    places = _holds(plan, rig.digitizer.oversampling)
    asked = np.array([0.0, *levels(rig)])
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
