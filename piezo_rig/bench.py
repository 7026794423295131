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
        with instrument_errors():
            self.interferometer.set_switch(rig.sensitivity_switch)
            settings = {
                "waveform_dac": self.dac.settings(),
                "digitizer": self.digitizer.settings(),
                "amplifier": self.amplifier.settings(),
                "interferometer": self.interferometer.settings(),
            }
        self.instruments = tuple(
            InstrumentRecord(
                name=name,
                idn=identities[name].raw,
                serial=identities[name].serial,
                settings=values,
            )
            for name, values in settings.items()
        )
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

    def play(self, name: str, wave: Wave, sample_rate: float) -> Recorded:
        """Play one sweep under hardware timing: the generator's burst triggers the digitizer."""
        setup = self.rig.digitizer
        count = wave.command_v.size * setup.oversampling
        ranges = {setup.sensor_channel: setup.sensor_range_v}
        if setup.monitor_channel:
            ranges[setup.monitor_channel] = setup.monitor_range_v
        duration = wave.command_v.size / sample_rate
        with instrument_errors():
            self.dac.load(name, wave.codes, wave.low_v, wave.high_v, sample_rate)
            self.digitizer.configure(sample_rate * setup.oversampling, count, ranges)
            self.digitizer.arm()
            started = self.clock.now()
            self.at_rest = False
            self.dac.start()
            self.dac.wait(duration)
            self.at_rest = True
            volts = self.digitizer.fetch(sorted(ranges), count)
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
        raise kind(error.code, str(error), error.cause, error.remedy) from error


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
    InputError : the config's ``[plant]`` table is wrong
    """
    from drivers.simulated.bench import SimulatedBench

    with SimulatedBench(simulated_plant(rig), clock) as simulated:
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

    try:
        return Plant(rig.plant)
    except ValueError as error:
        raise InputError(
            "config", f"{rig.path}: [plant] {error}", "a slip in the rig's config",
            "see the table of effects in docs/simulated-bench.md",
        ) from None
