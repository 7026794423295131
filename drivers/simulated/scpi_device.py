"""What every simulated SCPI instrument does: find the command, keep the error queue.

Bytes in, bytes out, no sockets. A subclass declares its commands; patterns are
written as in the instruments' manuals, ``[SOURce[1]:]VOLTage:HIGH``. Liberal in
what it accepts, strict in the rules for compound headers.
"""

from __future__ import annotations

import asyncio
import inspect
import re
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, MutableMapping
from dataclasses import dataclass
from typing import Any

from drivers.clock import Clock
from drivers.scpi import (
    ErrorEntry,
    ErrorQueue,
    MessageSplitter,
    ScpiSyntaxError,
    Unit,
    event_status_bit,
    header_pattern,
    parse_error_entry,
    parse_message,
    short_form,
)
from drivers.scpi_values import format_number, parse_boolean, parse_number, parse_word
from drivers.simulated.faults import Faults

Answer = str | bytes
Setter = Callable[[Unit], Awaitable[None] | None]
Getter = Callable[[Unit], Answer | Awaitable[Answer]]

_HEADER = re.compile(r"\*?[A-Z][A-Z0-9_:]*")


class ScpiError(Exception):
    """An execution error; the rest of the message is still executed."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.entry = ErrorEntry(code, text)


@dataclass
class Command:
    pattern: str
    set: Setter | None = None
    get: Getter | None = None
    most: int = 1  # arguments that it takes


async def pass_until(clock: Clock, instant: float) -> None:
    """Let bench time pass: a virtual clock jumps, a real one is waited for."""
    jump = getattr(clock, "advance_to", None)
    if jump is not None:
        jump(instant)
        return
    while (left := instant - clock.now()) > 0:
        await asyncio.sleep(left)


class ScpiDevice:
    """An instrument with common commands, an error queue of 20 and a settings table.

    Parameters
    ----------
    clock : bench time
    identification : the four fields of ``*IDN?``
    faults : what goes wrong, see `drivers.simulated.faults`
    """

    def __init__(
        self, clock: Clock, identification: str, faults: MutableMapping[str, Any] | None = None
    ) -> None:
        self.clock = clock
        self.identification = identification
        self.faults = Faults(faults, clock)
        self.errors = ErrorQueue()
        self.state: dict[str, Any] = {}
        self._defaults: dict[str, Any] = {}
        self._commands: list[Command] = []
        self._found: dict[str, Command | None] = {}
        self._event_status = 0
        self._masks = {"*ESE": 0, "*SRE": 0}
        self._declare_common()

    # -------------------------------------------------------------- execution

    def conversation(self) -> ScpiConversation:
        """One client's connection: what it sends is framed apart from the others'."""
        return ScpiConversation(self)

    async def execute(self, message: bytes) -> bytes | None:
        """Carry out one program message; the response message, or None."""
        answers: list[bytes] = []
        if fault := self.faults.strike("error_queue", message):
            self.report(parse_error_entry(str(fault.value)))
        try:
            for unit in parse_message(message):
                try:
                    answer = await self._execute_unit(unit)
                except ScpiError as error:
                    self.report(error.entry)
                    continue
                except (ScpiSyntaxError, asyncio.CancelledError):
                    raise
                except Exception as error:  # the client should hear of it, not just lose the line
                    self.report(ErrorEntry(-310, f"System error; {error}"))
                    continue
                if answer is not None:
                    raw = answer if isinstance(answer, bytes) else answer.encode("latin-1")
                    answers.append(raw)
        except ScpiSyntaxError as error:
            # The parser gives up on the rest of the message.
            self.report(ErrorEntry(error.code, error.text))
        return b";".join(answers) + b"\n" if answers else None

    async def _execute_unit(self, unit: Unit) -> Answer | None:
        # Clients that start again at the root without a colon are forgiven, as long as the
        # strict reading has no meaning.
        command = self._find(unit.header) or self._find(unit.written)
        action = None if command is None else (command.get if unit.query else command.set)
        if not _HEADER.fullmatch(unit.header):
            raise ScpiSyntaxError(-102, "Syntax error")
        if command is None or action is None:
            raise ScpiSyntaxError(-113, "Undefined header")
        if len(unit.arguments) > command.most:
            raise ScpiSyntaxError(-108, "Parameter not allowed")
        if not unit.query:
            swallowed = self.faults.strike("setting_not_taken")
            headers = swallowed.value if swallowed else ()
            if any(command is self._find(header.upper()) for header in headers):
                return None
        result: Any = action(unit)
        if inspect.isawaitable(result):
            result = await result
        return result if unit.query else None

    def _find(self, header: str) -> Command | None:
        if header not in self._found:
            matching = (c for c in self._commands if header_pattern(c.pattern).match(header))
            self._found[header] = next(matching, None)
        return self._found[header]

    def report(self, entry: ErrorEntry) -> None:
        """Put an entry into the error queue."""
        self.errors.push(entry)
        self._event_status |= event_status_bit(entry.code)

    # ------------------------------------------------------------ declarations

    def on(
        self,
        pattern: str,
        *,
        set: Setter | None = None,
        get: Getter | None = None,
        most: int = 1,
    ) -> None:
        """Declare a command: what sets it, what answers its query, its most arguments."""
        self._commands.append(Command(pattern, set, get, most))

    def switch(self, key: str, pattern: str, default: bool) -> None:
        """Declare an ON/OFF setting, kept in ``state[key]``."""
        self._defaults[key] = self.state[key] = default

        def change(unit: Unit) -> None:
            self._change(key, parse_boolean(unit.text(0)))

        self.on(pattern, set=change, get=lambda unit: str(int(self.state[key])))

    def choice(self, key: str, pattern: str, choices: Iterable[str], default: str) -> None:
        """Declare a setting that takes one of several words, kept in its short form."""
        words = tuple(choices)
        self._defaults[key] = self.state[key] = default

        def change(unit: Unit) -> None:
            word = unit.text(0)
            if word.upper().startswith("DEF") and not any(
                short_form(choice).startswith("DEF") for choice in words
            ):
                self._change(key, self._defaults[key])
            else:
                self._change(key, parse_word(word, words))

        self.on(pattern, set=change, get=lambda unit: str(self.state[key]))

    def number(self, key: str, pattern: str, default: float, lowest: float, highest: float) -> None:
        """Declare a number within limits; beyond them it is clipped, with error -222."""
        self._defaults[key] = self.state[key] = default
        words = {"MINimum": lowest, "MAXimum": highest, "DEFault": default}

        def change(unit: Unit) -> None:
            value = parse_number(unit.text(0), words)
            self._change(key, min(max(value, lowest), highest))
            if not lowest <= value <= highest:
                raise ScpiError(-222, "Data out of range; value clipped to limit")

        def tell(unit: Unit) -> str:
            if unit.arguments:
                return format_number(parse_number(unit.text(0), words))
            return format_number(self.state[key])

        self.on(pattern, set=change, get=tell)

    def _change(self, key: str, value: Any) -> None:
        self.state[key] = value
        self.changed(key)

    def changed(self, key: str) -> None:
        """Called after ``state[key]`` was set by a command."""

    # ----------------------------------------------------------- common commands

    def _declare_common(self) -> None:
        self.on("*IDN", get=lambda unit: self.identification)
        self.on("*OPT", get=lambda unit: "0")
        self.on("*TST", get=lambda unit: "+0")
        self.on("*CLS", set=lambda unit: self._clear_status())
        self.on("*RST", set=lambda unit: self.reset())
        self.on("*ESR", get=lambda unit: f"+{self._read_event_status()}")
        self.on("*STB", get=lambda unit: f"+{self._status_byte()}")
        self.on("*OPC", set=self._operation_complete, get=self._answer_when_complete)
        self.on("*WAI", set=self._wait)
        for mask in self._masks:
            self.on(mask, set=self._set_mask, get=lambda unit: f"+{self._masks[unit.header]}")
        self.on("SYSTem:ERRor[:NEXT]", get=self._next_error)
        self.on("SYSTem:ERRor:COUNt", get=lambda unit: f"+{len(self.errors)}")
        self.on("SYSTem:VERSion", get=lambda unit: "1999.0")

    def reset(self) -> None:
        """``*RST``: settings to their defaults; the error queue stays."""
        self.state.update(self._defaults)

    async def complete(self) -> None:
        """Return when no operation is pending."""

    def _next_error(self, unit: Unit) -> str:
        if self.faults.strike("stuck_queue"):
            return str(ErrorEntry(-310, "System error"))
        return str(self.errors.pop())

    def _clear_status(self) -> None:
        self.errors.clear()
        self._event_status = 0

    def _read_event_status(self) -> int:
        value, self._event_status = self._event_status, 0
        return value

    def _status_byte(self) -> int:
        event = bool(self._event_status & self._masks["*ESE"])
        return (4 if len(self.errors) else 0) | (32 if event else 0)

    def _set_mask(self, unit: Unit) -> None:
        self._masks[unit.header] = int(parse_number(unit.text(0))) & 0xFF

    def _operation_complete(self, unit: Unit) -> Any:
        async def later() -> None:
            await self.complete()
            self._event_status |= 1

        return later()

    async def _answer_when_complete(self, unit: Unit) -> str:
        await self.complete()
        return "1"

    def _wait(self, unit: Unit) -> Any:
        return self.complete()


class ScpiConversation:
    """Bytes in, messages carried out with their answers out."""

    def __init__(self, device: ScpiDevice) -> None:
        self._device = device
        self._splitter = MessageSplitter()

    async def feed(self, data: bytes) -> AsyncIterator[tuple[bytes, bytes]]:
        """Every message that ``data`` completes, and its answer, empty where there is none."""
        try:
            messages = self._splitter.feed(data)
        except ScpiSyntaxError as error:
            self._device.report(ErrorEntry(error.code, error.text))
            return
        for message in messages:
            yield message, await self._device.execute(message) or b""
