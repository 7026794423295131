"""The amplifier: a Thorlabs MDT69xB on a serial line, or one that only the config knows.

Never tried on hardware.

The amplifier's set voltage is added to 7.5 times the command: at 75 V of set
voltage, 0 V of command is full voltage on the stack. The driver reads the set
voltage and the limit and never changes either. Unverified: that ``xvoltage?``
answers the set voltage; on some units it may answer the voltage measured at the
output, which includes the external input.

Commands (115200 8N1, carriage return ends a command; the unit may echo it; the
answer may stand in square brackets; a prompt ``>`` or ``*`` ends everything):
``id?``, ``serial?``, ``xvoltage?``, ``vlimit?``. Source: Thorlabs, MDT693B and
MDT694B User Guide (HA0285T), chapter on remote communication, and transcripts
published with public drivers.
"""

from __future__ import annotations

import re
from typing import Protocol

from drivers.errors import InstrumentError
from drivers.identity import Identity
from drivers.transport import Transport

SET_TOLERANCE_V = 0.3  # the unit tells tenths of a volt
_PROMPT = re.compile(rb"[>*]\s*\Z")


class Amplifier(Protocol):
    """What turns the command into the drive; volts are drive volts."""

    identity: Identity | None

    def connect(self) -> Identity: ...

    def set_voltage(self) -> float: ...

    def voltage_limit(self) -> float: ...

    def settings(self) -> dict[str, str]: ...

    def close(self) -> None: ...


class ThorlabsMDT69x:
    """An MDT693B (channel X) or MDT694B. Never tried on hardware.

    Parameters
    ----------
    transport : serial line
    expected_set_v : the offset that the rig's config counts on, V
    expected_limit_v : the position of the output limit switch, V
    """

    def __init__(
        self, transport: Transport, expected_set_v: float = 75.0, expected_limit_v: float = 75.0
    ) -> None:
        self._transport = transport
        self._expected_set_v = expected_set_v
        self._expected_limit_v = expected_limit_v
        self.identity: Identity | None = None

    def connect(self) -> Identity:
        """Identify the unit and check set voltage and limit; changes nothing.

        InstrumentError instrument-identity, instrument-setting.
        """
        lines = self._ask("id?")
        text = "; ".join(lines)
        model = re.search(r"MDT69\d\w?", text, re.IGNORECASE)
        if model is None:
            raise InstrumentError(
                "instrument-identity",
                self._transport.instrument,
                f"{self._transport.address} answers id? with {text!r}, not as an MDT69x",
                "another device is on this serial port",
                "correct the address in the rig's config",
            )
        firmware = re.search(r"Version:?\s*([\w.]+)", text, re.IGNORECASE)
        serial = (self._ask("serial?") or [""])[-1].strip("[] ")
        self.identity = Identity(
            "Thorlabs", model.group().upper(), serial, firmware.group(1) if firmware else "", text
        )
        self._check("vlimit", self.voltage_limit(), self._expected_limit_v)
        self._check("xvoltage", self.set_voltage(), self._expected_set_v)
        return self.identity

    def _check(self, setting: str, answered: float, expected: float) -> None:
        if abs(answered - expected) > SET_TOLERANCE_V:
            raise InstrumentError(
                "instrument-setting",
                self._transport.instrument,
                f"{setting} should be {expected:g} V, answered {answered:g} V",
                "the amplifier was adjusted at its front panel",
                "with the actuator at rest, set it by hand, then run again",
            )

    def set_voltage(self) -> float:
        """The set voltage of channel X, V: the drive at 0 V of command."""
        return self._number("xvoltage?")

    def voltage_limit(self) -> float:
        """The output limit, V."""
        return self._number("vlimit?")

    def settings(self) -> dict[str, str]:
        """Every setting this driver relies on, query -> answer as it came."""
        return {query: "; ".join(self._ask(query)) for query in ("xvoltage?", "vlimit?")}

    def close(self) -> None:
        self._transport.close()

    def _number(self, query: str) -> float:
        lines = self._ask(query)
        found = re.search(r"[+-]?\d+(?:\.\d+)?", lines[-1]) if lines else None
        if found is None:
            raise InstrumentError(
                "instrument-garbage", self._transport.instrument, f"{query} answered {lines}"
            )
        return float(found.group())

    def _ask(self, query: str) -> list[str]:
        """The lines between the echo and the prompt."""
        try:
            self._transport.write(query.encode("ascii") + b"\r")
            raw = self._read_to_prompt(query)
        except InstrumentError as error:
            if error.code == "instrument-timeout":
                # A late answer must not be taken for the next one.
                self._transport.reopen()
            raise
        text = raw.decode("latin-1")
        lines = [line.strip(" >*") for line in re.split(r"[\r\n]+", text)]
        lines = [line for line in lines if line and line.lower() != query.lower()]
        if any("CMD_" in line.upper() or "ERROR" in line.upper() for line in lines):
            raise InstrumentError(
                "instrument-garbage", self._transport.instrument, f"{query} answered {lines}"
            )
        return lines

    def _read_to_prompt(self, query: str) -> bytes:
        """Up to the prompt that follows an answer.

        Some units send a prompt between the echo and the answer as well.
        """
        echo = query.encode("ascii").lower()
        raw = b""
        while True:
            raw += self._transport.read_exactly(1)
            if _PROMPT.search(raw) and raw.strip(b"\r\n >*").lower() not in (b"", echo):
                return raw


class ManualAmplifier:
    """An amplifier without a link: everything is as the rig's config says."""

    def __init__(
        self, set_voltage_v: float = 75.0, voltage_limit_v: float = 75.0, serial: str = ""
    ) -> None:
        self._set_voltage_v = set_voltage_v
        self._voltage_limit_v = voltage_limit_v
        self._serial = serial
        self.identity: Identity | None = None

    def connect(self) -> Identity:
        self.identity = Identity.manual("amplifier as configured, without a link", self._serial)
        return self.identity

    def set_voltage(self) -> float:
        return self._set_voltage_v

    def voltage_limit(self) -> float:
        return self._voltage_limit_v

    def settings(self) -> dict[str, str]:
        return {
            "set_voltage_v": f"{self._set_voltage_v:g}",
            "voltage_limit_v": f"{self._voltage_limit_v:g}",
        }

    def close(self) -> None:
        """Nothing to close."""
