"""The wired instruments of a rig: connect, arm, play, make safe.

A bench is all simulated or all real, decided by the serial numbers that the
instruments answer with, never by default. This module composes drivers; it
knows no bytes and no files.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.clock import BenchClock, Clock, RealClock, VirtualClock
from drivers.errors import InstrumentError
from piezo_rig.config import Rig
from piezo_rig.errors import BenchError, InputError, LimitError
from piezo_rig.guard import Keeper, Orders, Unguarded
from piezo_rig.protocol import Wave
from piezo_rig.run_file.layout import InstrumentRecord

Observer = Callable[[str, str, bytes], None]
Confirm = Callable[[str], bool]

RAMP_SHARE = 0.75
"""Of the slew limit, for ramps to rest: they go in steps."""
SECONDS_PER_SAMPLE = 2e-5
"""Fetching or storing one takes no longer, on a slow network or disk."""


@dataclass(frozen=True, eq=False)
class Recorded:
    """What the digitizer saw of one sweep, in volts, at its own rate."""

    sensor_v: NDArray[np.float64]
    monitor_v: NDArray[np.float64] | None
    start_time: float


class Bench:
    """Connected instruments. Made by ``open_bench``."""

    def __init__(
        self, rig: Rig, clock: Clock, dac: Any, digitizer: Any, amplifier: Any,
        interferometer: Any, keeper: Unguarded | None = None,
    ) -> None:
        self.rig = rig
        self.keeper = keeper or Unguarded()
        self.clock = clock
        self.dac = dac
        self.digitizer = digitizer
        self.amplifier = amplifier
        self.interferometer = interferometer
        self.origin = ""
        self.instruments: tuple[InstrumentRecord, ...] = ()
        self.touched = False  # whether anything was sent that could move the piezo
        self.at_rest = False
        self._burst_end = 0.0  # of the burst that may be playing, on the bench's clock

    def connect(self) -> None:
        """Identify every instrument and decide the run's origin; nothing moves yet.

        Raises
        ------
        LimitError : simulated and real instruments on one bench (exit 3)
        BenchError : an instrument does not answer, or is not the expected one (exit 4)
        """
        rig = self.rig
        with instrument_errors():
            identities = {
                "waveform_dac": self.dac.connect(),
                "digitizer": self.digitizer.connect(),
                "amplifier": self.amplifier.connect(),
                "interferometer": self.interferometer.connect(),
            }
        simulated = {
            name: identity.is_simulated for name, identity in identities.items()
            if not identity.is_manual
        }
        if len(set(simulated.values())) != 1:
            names = ", ".join(f"{n} {'simulated' if s else 'real'}" for n, s in simulated.items())
            raise LimitError(
                "bench-mixed", f"this bench is neither all real nor all simulated: {names}",
                "an address in the rig's config points to the wrong instrument",
                "mend the addresses in the rig's config",
            )
        self.origin = "SIMULATED" if simulated["waveform_dac"] else "REAL"
        with instrument_errors():
            self.interferometer.set_switch(rig.sensitivity_switch)
        self.instruments = self.read_settings()
        for name, link in (
            ("waveform_dac", rig.waveform_dac), ("digitizer", rig.digitizer.link),
            ("amplifier", rig.amplifier),
        ):
            serial = identities[name].serial
            if link.serial and serial != link.serial and not identities[name].is_manual:
                raise BenchError(
                    "instrument-identity",
                    f"{name}: serial number {serial}, the config expects {link.serial}",
                    "another instrument at this address", "mend the config or the cables",
                )

    def read_settings(self) -> tuple[InstrumentRecord, ...]:
        """Every instrument's identity and what its settings read back as now."""
        with instrument_errors():
            return tuple(
                InstrumentRecord(
                    name=name, idn=driver.identity.raw, serial=driver.identity.serial,
                    settings=driver.settings(),
                )
                for name, driver in (
                    ("waveform_dac", self.dac), ("digitizer", self.digitizer),
                    ("amplifier", self.amplifier), ("interferometer", self.interferometer),
                )
            )

    def drive_v(self) -> float:
        """Volts on the stack between bursts, from the generator's settings read back."""
        with instrument_errors():
            return self.rig.gain * float(self.dac.output_level()) + self.rig.offset_v

    def rest(self) -> dict[str, float]:
        """Bring the stack to 0 V without a jump; waits for a running burst first.

        Returns ``from_v``, ``to_v`` (volts on the stack) and ``duration_s``.
        """
        rig = self.rig
        if not self.touched:
            self.drive_v()  # refuses what somebody else plays, before anything is sent
        self.touched = True
        self.at_rest = False
        with instrument_errors():
            self.keeper.arm(self.dac.identity.serial)
            self.step("going to rest", self.ramp_s(rig.limits.drive_max_v))
            moved = self.dac.go_to_rest(
                rest_v=rig.rest_command_v,
                slew_v_per_s=RAMP_SHARE * rig.limits.rest_slew_v_per_s / rig.gain,
                clock=self.clock,
            )
        self.at_rest = True
        self._burst_end = 0.0
        return {
            "from_v": rig.gain * moved["from_v"] + rig.offset_v,
            "to_v": rig.gain * moved["to_v"] + rig.offset_v,
            "duration_s": moved["duration_s"],
        }

    def burst_left_s(self) -> float:
        """How long the burst that may be playing still lasts, s; 0 without one."""
        if not self._burst_end:
            return 0.0
        with instrument_errors():
            return max(0.0, self._burst_end - self.clock.now())

    def ramp_s(self, drive_v: float) -> float:
        """How long a ramp from this drive to rest takes, s."""
        return abs(drive_v) / (RAMP_SHARE * self.rig.limits.rest_slew_v_per_s)

    def step(self, name: str, expected_s: float = 0.0) -> None:
        """What the runner does now, and how long at most, for the guard."""
        self.keeper.step(name, expected_s)

    def check_guard(self) -> None:
        """BenchError guard-lost when nobody would bring the stack to rest any more."""
        with instrument_errors():
            self.keeper.check()

    def _ranges(self) -> dict[int, float]:
        setup = self.rig.digitizer
        ranges = {setup.sensor_channel: setup.sensor_range_v}
        if setup.monitor_channel:
            ranges[setup.monitor_channel] = setup.monitor_range_v
        return ranges

    def load(self, name: str, wave: Wave, sample_rate: float) -> None:
        """Make one sweep ready on generator and digitizer; nothing moves."""
        factor = self.rig.digitizer.oversampling
        with instrument_errors():
            self.amplifier.check()
            self.dac.load(name, wave.codes, wave.low_v, wave.high_v, sample_rate)
            self.digitizer.configure(
                sample_rate * factor, wave.command_v.size * factor, self._ranges()
            )

    def play(self, name: str, wave: Wave, sample_rate: float) -> Recorded:
        """Play one sweep under hardware timing: the generator's burst triggers the digitizer."""
        setup = self.rig.digitizer
        ranges = self._ranges()
        duration_s = wave.codes.size / sample_rate
        self.step(f"loading {name}")
        self.load(name, wave, sample_rate)
        with instrument_errors():
            self.step(f"arming {name}")
            self.digitizer.arm()
            started = self.clock.now()
            self.at_rest = False
            self._burst_end = started + duration_s
            self.step(f"starting {name}")
            self.dac.start()
            self.step(f"playing {name}", duration_s)
            self.dac.wait(duration_s)
            self.at_rest = True
            self._burst_end = 0.0
            count = wave.command_v.size * setup.oversampling
            self.step(f"fetching {name}", count * SECONDS_PER_SAMPLE)
            volts = self.digitizer.fetch(sorted(ranges), count)
        return Recorded(
            sensor_v=volts[setup.sensor_channel],
            monitor_v=volts.get(setup.monitor_channel),
            start_time=started,
        )

    @property
    def may_be_left(self) -> bool:
        """Whether nothing is left to be done: the stack is at rest, or was never moved."""
        return self.at_rest or not self.touched

    def piezo(self) -> str:
        """Where the piezo is, in words for an error message."""
        if not self.touched:
            return "not touched; nothing was sent that moves it"
        if self.at_rest:
            return "at 0 V (the generator rests at the lowest command)"
        return "NOT known to be at 0 V: " + (
            "the guard goes on trying; if the generator stays away, "
            if isinstance(self.keeper, Keeper) else ""
        ) + "switch the amplifier off by hand"


@contextmanager
def instrument_errors() -> Iterator[None]:
    """Drivers' errors as errors of the application (exit 4; a refusal is exit 3)."""
    try:
        yield
    except InstrumentError as error:
        refused = error.code in ("bench-refused", "bench-busy")
        kind = LimitError if refused else BenchError
        cause, remedy = _USUAL.get(error.code, ("", ""))
        raise kind(
            error.code, str(error), error.cause or cause, error.remedy or remedy
        ) from error


_SEE_LINE = "check power, cable and address; then run again"
_USUAL = {
    "instrument-refused": ("it is off, or another address", _SEE_LINE),
    "instrument-timeout": ("it is off, hangs, or the line is cut", _SEE_LINE),
    "instrument-hangup": ("it was switched off or restarted, or the line is cut", _SEE_LINE),
    "instrument-garbage": (
        "another kind of instrument at this address, or another program talks to it too",
        "check the address, and that nothing else holds the line; then run again",
    ),
    "instrument-block": (
        "the transfer was cut short, or another program talks to the instrument too",
        "check the line, and that nothing else holds it; then run again",
    ),
    "instrument-error-queue": (
        "the instrument does not accept the command that is named",
        "compare its firmware with the driver's; the transcript in the run has every byte",
    ),
    "instrument-setting": (
        "the instrument does not have that setting, or somebody changed it at the front panel",
        "leave the front panel alone while a run plays; then run again",
    ),
}
"""Likely cause and remedy by code, where the driver knows nothing better."""


@contextmanager
def open_bench(
    rig: Rig, confirm: Confirm, observer: Observer | None = None, clock: Clock | None = None,
    report: Path | None = None, tell: Callable[[str], None] = lambda text: None,
) -> Iterator[Bench]:
    """Connect a rig's instruments; on leaving, the lines are closed.

    The generator's line is held by a guard process, which brings the stack to rest if this
    process cannot. A simulated bench in this very process ends with it and has none.

    Parameters
    ----------
    rig : the config; a simulated one gets its instruments started on real transports
    confirm : asks the operator a yes-or-no question (the interferometer's switch)
    observer : sees every byte: instrument, direction (``out``, ``in``, ``event``), data
    clock : replaces the clock that the config names
    report : where the guard writes what it did, if it has to act
    tell : takes a line about what is waited for

    Raises
    ------
    see ``Bench.connect``
    """
    from drivers.interferometer import SiosSPS120
    from drivers.kinds import CARD, make_amplifier, make_dac, make_digitizer
    from drivers.transport import open_transport

    with ExitStack() as stack:
        if rig.simulated:
            clock = clock or (VirtualClock() if rig.clock == "virtual" else RealClock())
            rig = stack.enter_context(simulated_instruments(rig, clock))
        elif clock is None:
            with instrument_errors():
                clock = RealClock() if rig.clock == "real" else BenchClock(rig.clock)
        close = getattr(clock, "close", None)
        if close:
            stack.callback(close)

        def watch(name: str) -> Callable[[str, bytes], None]:
            return lambda direction, data: observer(name, direction, data) if observer else None

        def line(name: str, link: Any) -> Any:
            transport = open_transport(link.address, name, link.timeout_s, observer=watch(name))
            stack.callback(transport.close)
            return transport

        keeper = Unguarded()
        bench: Bench | None = None
        driver = rig.waveform_dac.driver
        with instrument_errors():
            if rig.simulated:
                dac = make_dac(driver, line("waveform_dac", rig.waveform_dac), clock)
            else:
                keeper = guard = Keeper(orders(rig, report), tell)
                stack.callback(lambda: guard.end(bench is None or bench.may_be_left))
                dac = make_dac(driver, guard.transport(watch("waveform_dac")), clock)
                stack.callback(dac.close)
            link = rig.digitizer.link
            if driver == CARD:
                watch("digitizer")("event", b"opened on the line of waveform_dac")
            digitizer = make_digitizer(
                driver, None if driver == CARD else line("digitizer", link), dac, clock,
                link.address, rig.digitizer.sensor_channel,
            )
            amplifier = make_amplifier(
                rig.amplifier.driver, lambda: line("amplifier", rig.amplifier),
                rig.set_voltage_v, rig.limits.drive_max_v, rig.amplifier.serial,
            )
        # A simulated switch cannot stand wrong by accident; a real one is asked for.
        interferometer = SiosSPS120(
            (lambda question: _is_simulated(dac) or confirm(question)),
            rig.interferometer_calibration.sensitivities_um_per_v,
            rig.interferometer.serial,
        )
        bench = Bench(rig, clock, dac, digitizer, amplifier, interferometer, keeper)
        bench.connect()
        yield bench


def orders(rig: Rig, report: Path | None) -> Orders:
    """What the guard of a rig's generator is told."""
    return Orders(
        address=rig.waveform_dac.address, timeout_s=rig.waveform_dac.timeout_s, clock=rig.clock,
        rest_command_v=rig.rest_command_v,
        slew_v_per_s=RAMP_SHARE * rig.limits.rest_slew_v_per_s / rig.gain,
        gain=rig.gain, offset_v=rig.offset_v,
        report=str(report.resolve()) if report else "", driver=rig.waveform_dac.driver,
    )


def _is_simulated(dac: Any) -> bool:
    return dac.identity is not None and dac.identity.is_simulated


@contextmanager
def simulated_instruments(rig: Rig, clock: Clock) -> Iterator[Rig]:
    """Start simulated instruments; yields the rig with their addresses filled in.

    Raises
    ------
    InputError : the config's ``[plant]`` or ``[faults]`` table is wrong
    """
    from drivers.simulated.bench import SimulatedBench

    with SimulatedBench(
        simulated_plant(rig), clock, faults=simulated_faults(rig), card=rig.is_card,
        amplifier=rig.amplifier.driver,
    ) as simulated:
        where = simulated.addresses
        yield replace(
            rig,
            waveform_dac=replace(rig.waveform_dac, address=where["waveform_dac"]),
            digitizer=replace(
                rig.digitizer, link=replace(rig.digitizer.link, address=where["digitizer"])
            ),
            amplifier=replace(rig.amplifier, address=where["amplifier"]),
        )


def simulated_plant(rig: Rig) -> Any:
    """The plant that a simulated rig's config describes."""
    from drivers.simulated.plant import Plant

    return Plant(plant_config(rig))


def simulated_faults(rig: Rig) -> dict[str, Any]:
    """The faults of instruments and lines that a simulated rig's config switches on.

    Raises
    ------
    InputError : the ``[faults]`` table holds an unknown key or a value that does not fit
    """
    from drivers.simulated.faults import check_faults

    try:
        return dict(check_faults(rig.faults))
    except ValueError as error:
        raise InputError(
            "config", f"{rig.path}: [faults] {error}", "a slip in the rig's config",
            "see the table of faults in docs/simulated-bench.md",
        ) from None


def plant_config(rig: Rig) -> Any:
    """The settings of a simulated rig's plant, checked; cheap.

    Raises
    ------
    InputError : the ``[plant]`` table holds an unknown key or a value that does not fit
    """
    from drivers.simulated.plant.config import PlantConfig

    try:
        return PlantConfig.from_mapping(rig.plant)
    except ValueError as error:
        raise InputError(
            "config", f"{rig.path}: [plant] {error}", "a slip in the rig's config",
            "see the table of effects in docs/simulated-bench.md",
        ) from None
