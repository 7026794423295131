"""Every instrument by itself: it answers, its error queue is empty, it is the expected one."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from typing import Any

from drivers.clock import Clock, RealClock, VirtualClock
from piezo_rig.bench import instrument_errors, simulated_instruments
from piezo_rig.config import Rig
from piezo_rig.doctor.check import Check
from piezo_rig.errors import PiezoRigError
from piezo_rig.guard.lock import hold


def one_by_one(rig: Rig) -> Iterator[Check]:
    """Checks of single instruments; nothing moves."""
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
    from drivers.digitizer import KeysightL4532A
    from drivers.kinds import make_amplifier, make_dac

    yield from _instrument(
        "waveform_dac", rig.waveform_dac,
        lambda line: make_dac(rig.waveform_dac.driver, line, clock), True,
    )
    if not rig.is_card:
        yield from _instrument(
            "digitizer", rig.digitizer.link, lambda line: KeysightL4532A(line, clock), True
        )
    if rig.amplifier.driver == "manual":
        yield Check(
            "note", "amplifier", f"has no link: see that its set voltage is {rig.set_voltage_v:g} "
            f"V and its limit {rig.limits.drive_max_v:g} V",
        )
    else:
        yield from _instrument(
            "amplifier", rig.amplifier,
            lambda line: make_amplifier(
                rig.amplifier.driver, lambda: line, rig.set_voltage_v, rig.limits.drive_max_v, ""
            ), False,
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
