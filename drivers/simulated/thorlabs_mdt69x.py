"""A simulated Thorlabs MDT694B on a serial line: echo, bracketed answers, prompt.

The dialogue follows transcripts published with public drivers: the unit echoes
the command, answers in square brackets, ends lines with a carriage return and
everything with a prompt.
"""

from __future__ import annotations

import re
from collections.abc import AsyncIterator, MutableMapping
from typing import Any

from drivers.simulated.faults import Faults
from drivers.simulated.wiring import Wiring

PROMPT = b"> "


class SimulatedThorlabsMDT69x:
    """Bytes in, bytes out; the set voltage goes to the plant as the amplifier's offset."""

    def __init__(
        self,
        wiring: Wiring,
        serial: str = "SIM00003",
        faults: MutableMapping[str, Any] | None = None,
        set_voltage_v: float = 75.0,
        voltage_limit_v: float = 75.0,
    ) -> None:
        self._wiring = wiring
        self._serial = serial
        self.faults = Faults(faults, wiring.clock)
        self._set_v = set_voltage_v
        self._limit_v = voltage_limit_v
        self._echo = True
        self._buffer = b""
        wiring.set_amplifier_offset(set_voltage_v)

    def conversation(self) -> SimulatedThorlabsMDT69x:
        """A serial line has one client."""
        return self

    async def feed(self, data: bytes) -> AsyncIterator[tuple[bytes, bytes]]:
        """Every command that ``data`` completes, and what the unit sends back."""
        self._buffer += data
        while (found := re.search(rb"[\r\n]", self._buffer)) is not None:
            command = self._buffer[: found.start()].decode("latin-1").strip()
            self._buffer = self._buffer[found.end() :]
            if command:
                echo = command.encode("latin-1") + b"\r" if self._echo else b""
                yield command.encode("latin-1"), echo + self._answer(command.lower()) + PROMPT

    def _answer(self, command: str) -> bytes:
        if fault := self.faults.strike("adjusted", command.encode("latin-1")):
            self._set_v = float(fault.value)
            self._wiring.set_amplifier_offset(self._set_v)
        name, equals, value = command.partition("=")
        if equals:
            return self._change(name.strip(), value.strip())
        answers = {
            "id?": (
                "\rModel MDT694B Piezo Control Module\rFirmware Version: 1.09\r"
                f"Voltage Range: {self._limit_v:g} Volts"
            ),
            "serial?": self._serial,
            "vlimit?": f"[ {self._limit_v:.0f}]",
            "xvoltage?": f"[{self._set_v:6.1f}]",
            "xmin?": "[   0.0]",
            "xmax?": f"[{self._limit_v:6.1f}]",
            "echo?": f"[{int(self._echo)}]",
        }
        answer = answers.get(command)
        return b"CMD_NOT_DEFINED\r" if answer is None else answer.encode("latin-1") + b"\r"

    def _change(self, name: str, value: str) -> bytes:
        try:
            number = float(value)
        except ValueError:
            return b"CMD_ARG_INVALID\r"
        if name == "xvoltage":
            if not 0 <= number <= self._limit_v:
                return b"CMD_ARG_INVALID\r"
            self._set_v = round(number, 1)
            self._wiring.set_amplifier_offset(self._set_v)
            return b""
        if name == "echo":
            self._echo = bool(number)
            return b""
        return b"CMD_NOT_DEFINED\r"
