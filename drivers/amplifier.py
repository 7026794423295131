"""The amplifier: a Thorlabs MDT69xB on a serial line, or one that only the config knows.

Never tried on hardware.

The amplifier's set voltage is added to 7.5 times the command: at 75 V of set
voltage, 0 V of command is full voltage on the stack. The driver reads the set
voltage and the limit and never changes either. Unverified: that ``xvoltage?``
answers the set voltage; on some units it may answer the voltage measured at the
output, which includes the external input.

Commands (115200 8N1, carriage return ends a command; the unit may echo it; the
answer may stand in square brackets; a prompt ``>`` or ``*`` ends everything). A
serial line has no connections to drop, so an answer that came too late may still
be on its way. Two things keep it from being taken for another: an echo must be
that of the question, and after a failure the line is emptied up to an answer
that only ``id?`` has.
Commands:
``id?``, ``serial?``, ``xvoltage?``, ``vlimit?``. Source: Thorlabs, MDT693B and
MDT694B User Guide (HA0285T), chapter on remote communication, and transcripts
published with public drivers.
"""

from __future__ import annotations

import re
from typing import Protocol

from drivers.errors import InstrumentError
from drivers.identity import Identity
from drivers.scpi_instrument import RECOVERY_S
from drivers.transport import Transport

SET_TOLERANCE_V = 0.3  # the unit tells tenths of a volt
_PROMPT = re.compile(rb"[>*]\s*\Z")
_MODEL = re.compile(r"MDT69\d\w?", re.IGNORECASE)
_NUMBER = re.compile(r"\[?\s*([+-]?\d+(?:\.\d+)?)\s*V?\s*\]?", re.IGNORECASE)
_NOISE = re.compile(rb"[^\x20-\x7e\r\n\t]")
_LONGEST_ANSWER = 4096


class Amplifier(Protocol):
    """What turns the command into the drive; volts are drive volts."""

    identity: Identity | None

    def connect(self) -> Identity: ...

    def set_voltage(self) -> float: ...

    def voltage_limit(self) -> float: ...

    def check(self) -> None:
        """Make sure, at rest, that it answers and stands as it did at the first `check`."""
        ...

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
        self._stood: dict[str, float] = {}
        self._stale = False
        self.identity: Identity | None = None

    def connect(self) -> Identity:
        """Identify the unit and check set voltage and limit; changes nothing.

        InstrumentError instrument-identity, instrument-setting.
        """
        self._stood.clear()
        text = "; ".join(self._ask("id?"))
        model = _MODEL.search(text)
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

    def check(self) -> None:
        """Make sure, at rest, that the unit answers and stands as it did at the first `check`.

        Compared is what the unit says at rest with what it said at rest: on a unit
        whose ``xvoltage?`` includes the external input that is not the set voltage.
        InstrumentError instrument-setting.
        """
        for query in ("vlimit?", "xvoltage?"):
            stood = self._stood.setdefault(query, now := self._number(query))
            if abs(now - stood) > SET_TOLERANCE_V:
                raise InstrumentError(
                    "instrument-setting",
                    self._transport.instrument,
                    f"{query} answered {stood:g} V when the run began and now {now:g} V",
                    "the amplifier was adjusted at its front panel while the run played",
                    "set it back by hand, then run again",
                )

    def settings(self) -> dict[str, str]:
        """Every setting this driver relies on, query -> answer as it came."""
        return {query: "; ".join(self._ask(query)) for query in ("xvoltage?", "vlimit?")}

    def close(self) -> None:
        self._transport.close()

    def _number(self, query: str) -> float:
        lines = self._ask(query)
        found = _NUMBER.fullmatch(lines[0]) if len(lines) == 1 else None
        if found is None:
            raise self._garbage(f"{query} answered {_shown(lines)}")
        return float(found.group(1))

    def _garbage(self, what: str) -> InstrumentError:
        self._stale = True
        return InstrumentError("instrument-garbage", self._transport.instrument, what)

    def _ask(self, query: str) -> list[str]:
        """The lines between the echo and the prompt."""
        if self._stale:
            self._recover()
        try:
            with self._transport.within():
                unasked = self._transport.take_unasked()
                if unasked.strip(b"\r\n >*"):
                    raise self._garbage(f"sent {unasked[:40]!r}, which nobody asked for")
                self._transport.write(query.encode("ascii") + b"\r")
                raw = self._read_to_prompt(query)
        except BaseException:
            self._stale = True
            raise
        lines = _lines(raw)
        if lines and lines[0].lower() == query:
            lines = lines[1:]
        if any(re.fullmatch(r"\w+\?", line) for line in lines):
            raise self._garbage(f"{query} was answered with the echo of another: {_shown(lines)}")
        if any("CMD_" in line.upper() or "ERROR" in line.upper() for line in lines):
            raise self._garbage(f"{query} answered {_shown(lines)}")
        return lines

    def _read_to_prompt(self, query: str) -> bytes:
        """Up to the prompt that follows an answer.

        Some units send a prompt between the echo and the answer as well.
        """
        echo = query.encode("ascii").lower()
        raw = b""
        while True:
            raw += self._transport.read_some()
            if _NOISE.search(raw):
                raise self._garbage(f"{query} is answered with noise: {raw[:40]!r}")
            if _PROMPT.search(raw) and raw.strip(b"\r\n >*").lower() not in (b"", echo):
                return raw
            if len(raw) > _LONGEST_ANSWER:
                raise self._garbage(f"{query} is answered without an end: {raw[:40]!r}...")

    def _recover(self) -> None:
        """Open the line afresh and pass over late answers: answers keep the order of questions."""
        with self._transport.within(RECOVERY_S):
            self._transport.reopen()
            self._transport.write(b"\rid?\r")
            raw = b""
            while not (_PROMPT.search(raw) and _MODEL.search(raw.decode("latin-1"))):
                raw = raw[-_LONGEST_ANSWER:] + self._transport.read_some()
        self._stale = False


def _lines(raw: bytes) -> list[str]:
    found = (line.strip(" >*") for line in re.split(r"[\r\n]+", raw.decode("latin-1")))
    return [line for line in found if line]


def _shown(lines: list[str]) -> str:
    return ascii("; ".join(lines)[:80])


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

    def check(self) -> None:
        """Nothing to ask."""

    def settings(self) -> dict[str, str]:
        return {
            "set_voltage_v": f"{self._set_voltage_v:g}",
            "voltage_limit_v": f"{self._voltage_limit_v:g}",
        }

    def close(self) -> None:
        """Nothing to close."""
