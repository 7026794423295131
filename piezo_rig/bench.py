"""The wired instruments of a rig: connect, arm, play, make safe.

A bench is all simulated or all real, decided by the serial numbers that the
instruments answer with, never by default. This module composes drivers; it
knows no bytes and no files.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.clock import BenchClock, Clock, RealClock, VirtualClock
from drivers.errors import InstrumentError
from piezo_rig.config import Rig
from piezo_rig.errors import BenchError, InputError, LimitError
from piezo_rig.protocol import Wave
from piezo_rig.run_file.layout import InstrumentRecord

Observer = Callable[[str, str, bytes], None]
Confirm = Callable[[str], bool]


@dataclass(frozen=True, eq=False)
class Recorded:
    """What the digitizer saw of one sweep, in volts, at its own rate."""

    sensor_v: NDArray[np.float64]
    monitor_v: NDArray[np.float64] | None
    start_time: float


class Bench:
    """Connected instruments. Made by ``open_bench``."""

    def __init__(
        self, rig: Rig, clock: Clock, dac: Any, digitizer: Any, amplifier: Any, interferometer: Any
    ) -> None:
        self.rig = rig
        self.clock = clock
        self.dac = dac
        self.digitizer = digitizer
        self.amplifier = amplifier
        self.interferometer = interferometer
        self.origin = ""
        self.instruments: tuple[InstrumentRecord, ...] = ()
        self.touched = False  # whether anything was sent that could move the piezo
        self.at_rest = False

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
        if self.origin == "REAL":
            raise LimitError(
                "bench-real", "this bench is REAL, and this version plays simulated benches only",
                "without a guard process a killed program could leave 75 V on the stack",
                "use the simulated bench; real ones are opened by the release that has the guard",
            )
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

    def rest(self) -> dict[str, float]:
        """Bring the stack to 0 V without a jump; waits for a running burst first.

        Returns ``from_v``, ``to_v`` (volts on the stack) and ``duration_s``.
        """
        self.touched = True
        rig = self.rig
        with instrument_errors():
            moved = self.dac.go_to_rest(
                rest_v=rig.rest_command_v,
                slew_v_per_s=rig.limits.rest_slew_v_per_s / rig.gain,
                clock=self.clock,
            )
        self.at_rest = True
        return {
            "from_v": rig.gain * moved["from_v"] + rig.offset_v,
            "to_v": rig.gain * moved["to_v"] + rig.offset_v,
            "duration_s": moved["duration_s"],
        }

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
        self.load(name, wave, sample_rate)
        with instrument_errors():
            self.digitizer.arm()
            started = self.clock.now()
            self.at_rest = False
            self.dac.start()
            self.dac.wait(wave.command_v.size / sample_rate)
            self.at_rest = True
            volts = self.digitizer.fetch(sorted(ranges), wave.command_v.size * setup.oversampling)
        return Recorded(
            sensor_v=volts[setup.sensor_channel],
            monitor_v=volts.get(setup.monitor_channel),
            start_time=started,
        )

    def piezo(self) -> str:
        """Where the piezo is, in words for an error message."""
        if not self.touched:
            return "not touched; nothing was sent that moves it"
        if self.at_rest:
            return "at 0 V (the generator rests at the lowest command)"
        return "NOT known to be at 0 V: switch the amplifier off by hand"


@contextmanager
def instrument_errors() -> Iterator[None]:
    """Drivers' errors as errors of the application (exit 4; a refusal is exit 3)."""
    try:
        yield
    except InstrumentError as error:
        kind = LimitError if error.code == "bench-refused" else BenchError
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
    rig: Rig, confirm: Confirm, observer: Observer | None = None, clock: Clock | None = None
) -> Iterator[Bench]:
    """Connect a rig's instruments; on leaving, the lines are closed.

    Parameters
    ----------
    rig : the config; a simulated one gets its instruments started on real transports
    confirm : asks the operator a yes-or-no question (the interferometer's switch)
    observer : sees every byte: instrument, direction (``out``, ``in``, ``event``), data
    clock : replaces the clock that the config names

    Raises
    ------
    see ``Bench.connect``
    """
    from drivers.amplifier import ManualAmplifier, ThorlabsMDT69x
    from drivers.digitizer import KeysightL4532A
    from drivers.interferometer import SiosSPS120
    from drivers.transport import open_transport
    from drivers.waveform_dac import Keysight33500B

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

        def line(name: str, link: Any) -> Any:
            def watch(direction: str, data: bytes) -> None:
                if observer:
                    observer(name, direction, data)

            transport = open_transport(link.address, name, link.timeout_s, observer=watch)
            stack.callback(transport.close)
            return transport

        with instrument_errors():
            dac = Keysight33500B(line("waveform_dac", rig.waveform_dac))
            digitizer = KeysightL4532A(line("digitizer", rig.digitizer.link), clock)
            amplifier: Any
            if rig.amplifier.driver == "manual":
                amplifier = ManualAmplifier(
                    rig.offset_v, rig.limits.drive_max_v, rig.amplifier.serial
                )
            else:
                amplifier = ThorlabsMDT69x(
                    line("amplifier", rig.amplifier), rig.offset_v, rig.limits.drive_max_v
                )
        # A simulated switch cannot stand wrong by accident; a real one is asked for.
        interferometer = SiosSPS120(
            (lambda question: _is_simulated(dac) or confirm(question)),
            rig.interferometer_calibration.sensitivities_um_per_v,
            rig.interferometer.serial,
        )
        bench = Bench(rig, clock, dac, digitizer, amplifier, interferometer)
        bench.connect()
        yield bench


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

    with SimulatedBench(simulated_plant(rig), clock, faults=simulated_faults(rig)) as simulated:
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
