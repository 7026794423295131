"""The client side of SCPI: ask, set and read back, drain the error queue, fetch blocks.

Whatever is set is read back in the same message, together with the first entry
of the error queue: one round trip, and nothing is believed unseen. After a
timeout the line is stale: a late answer would be taken for the next one. The
next exchange therefore closes it, opens it again, asks ``*IDN?`` and clears.
Bytes that nobody asked for mean that question and answer are out of step: they
make the line stale too, and are never taken for an answer.

An exchange has one deadline, however many answers it is made of, and getting a
line back after a failure has `RECOVERY_S` in all: a failed instrument is told
within its timeout and two seconds.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from drivers.errors import InstrumentError
from drivers.identity import Identity
from drivers.scpi import (
    BlockParser,
    ErrorEntry,
    ScpiSyntaxError,
    encode_block,
    parse_error_entry,
    split_answers,
)
from drivers.scpi_values import INFINITE, same_arb, same_boolean, same_number, same_word
from drivers.transport import Transport

RECOVERY_S = 1.7
_SHORTEST_RECOVERY_S = 0.2
_MOST_ERRORS = 25  # one more than any queue holds, so that a stuck queue ends
_SHOWN_ERRORS = 4
_LONGEST_IDENTITY = 256  # IEEE 488.2 has 72
_STALING = ("instrument-timeout", "instrument-hangup", "instrument-garbage", "instrument-block")


@dataclass(frozen=True)
class Setting:
    """One thing to set, and how to see that it took.

    command : as sent, with its value; empty to check without setting
    query : the query of the same setting
    asked : the value in words, for messages
    agrees : whether an answer means that value
    """

    command: str
    query: str
    asked: str
    agrees: Callable[[str], bool]

    @classmethod
    def number(cls, header: str, value: float, *, absolute: float = 5e-4) -> Setting:
        text = "INF" if value >= INFINITE else f"{value:.9g}"
        return cls(
            f"{header} {text}", f"{header}?", text,
            lambda answer: same_number(value, answer, absolute=absolute),
        )  # fmt: skip

    @classmethod
    def word(cls, header: str, value: str) -> Setting:
        return cls(
            f"{header} {value}", f"{header}?", value, lambda answer: same_word(value, answer)
        )

    @classmethod
    def switch(cls, header: str, on: bool) -> Setting:
        text = "ON" if on else "OFF"
        return cls(f"{header} {text}", f"{header}?", text, lambda answer: same_boolean(on, answer))

    @classmethod
    def arb(cls, header: str, name: str) -> Setting:
        return cls(f"{header} {name}", f"{header}?", name, lambda answer: same_arb(name, answer))


class ScpiInstrument:
    """SCPI over a `Transport`; knows no particular instrument."""

    def __init__(self, transport: Transport) -> None:
        self.transport = transport
        self.name = transport.instrument
        self.identity: Identity | None = None
        self._stale = False
        self._recovering_s = 0.0  # spent on getting the line back since it failed

    # ------------------------------------------------------------- connecting

    def connect(self, models: Sequence[str]) -> Identity:
        """Ask who is there, and clear the status.

        ``models`` are the beginnings of the model names that will do.
        InstrumentError instrument-refused, -timeout, -identity.
        """
        identity = self._identify()
        if not any(identity.model.upper().startswith(model.upper()) for model in models):
            raise InstrumentError(
                "instrument-identity",
                self.name,
                f"{self.transport.address} answers as {identity.raw!r}, "
                f"not as one of {', '.join(models)}",
                "the addresses of two instruments are exchanged in the rig's config",
                "correct the address",
            )
        self.identity = identity
        self.write("*CLS")
        self.drain_errors("*CLS")
        return identity

    def _identify(self) -> Identity:
        return self._identity_in(self.query("*IDN?"))

    def _identity_in(self, answer: str) -> Identity:
        try:
            if len(answer) > _LONGEST_IDENTITY:
                raise ValueError(answer)
            return Identity.from_idn(answer)
        except ValueError:
            raise InstrumentError(
                "instrument-garbage",
                self.name,
                f"*IDN? answered {_shown(answer)}, which is no identification",
                "something else listens at this address",
            ) from None

    def close(self) -> None:
        self.transport.close()

    # -------------------------------------------------------------- exchanges

    def write(self, message: str) -> None:
        """Send a message that has no answer."""
        with self._line():
            self.transport.write(message.encode("latin-1") + b"\n")

    def query(self, message: str, timeout_s: float | None = None) -> str:
        """Send a message and return its one line of answer."""
        with self._line(timeout_s):
            self.transport.write(message.encode("latin-1") + b"\n")
            return self._read_text()

    def query_all(self, *queries: str) -> list[str]:
        """Several queries in one message; their answers in order."""
        return self._ask(";".join(_absolute(query) for query in queries), len(queries))

    def _ask(self, message: str, count: int) -> list[str]:
        with self._line():
            self.transport.write(message.encode("latin-1") + b"\n")
            answers = split_answers(self._read_text())
            while len(answers) < count:  # some instruments answer on separate lines
                answers += split_answers(self._read_text())
        if len(answers) != count:
            self._stale = True
            raise InstrumentError(
                "instrument-garbage",
                self.name,
                f"{message!r} asks {count} things and was answered {len(answers)}: "
                f"{_shown('; '.join(answers))}",
            )
        return answers

    def query_block(
        self, message: str, most: int | None = None, timeout_s: float | None = None
    ) -> bytes:
        """Ask for a definite-length block of at most ``most`` bytes.

        InstrumentError instrument-block when it is longer, damaged or cut short.
        """
        parser = BlockParser()
        with self._line(timeout_s):
            self.transport.write(message.encode("latin-1") + b"\n")
            try:
                while parser.needed:
                    parser.feed(self.transport.read_exactly(parser.needed))
                    if most is not None and (parser.size or 0) > most:
                        raise self._bad_block(message, f"{parser.size} bytes, {most} were due")
                trailer = self.transport.read_exactly(1)
                if trailer == b"\r":
                    trailer = self.transport.read_exactly(1)
            except ScpiSyntaxError as error:
                raise InstrumentError(
                    "instrument-garbage", self.name, f"{message!r} answered no block: {error}"
                ) from error
            except InstrumentError as error:
                if error.code == "instrument-timeout" and parser.begun:
                    raise self._bad_block(message, f"did not come whole; {error.what}") from error
                raise
            if trailer != b"\n":
                raise self._bad_block(message, "more bytes than announced, or no line feed")
        return parser.payload

    def _bad_block(self, message: str, what: str) -> InstrumentError:
        return InstrumentError("instrument-block", self.name, f"{message!r}: {what}")

    def send_block(self, head: str, payload: bytes) -> None:
        """Send ``head`` followed by a block, then drain the error queue."""
        with self._line():
            self.transport.write(head.encode("latin-1") + encode_block(payload) + b"\n")
        self.drain_errors(head)

    # ---------------------------------------------------------------- setting

    def apply(self, *settings: Setting) -> None:
        """Set, read back, and drain the error queue, all in one message.

        InstrumentError instrument-error-queue for what the instrument says went
        wrong, instrument-setting for an answer that is not what was asked.
        """
        commands = [_absolute(setting.command) for setting in settings if setting.command]
        queries = [_absolute(setting.query) for setting in settings]
        message = ";".join([*commands, *queries, ":SYST:ERR?"])
        said = "; ".join(setting.command for setting in settings if setting.command)
        try:
            answers = self._ask(message, len(queries) + 1)
        except InstrumentError as failure:
            # An instrument drops the rest of a message after a syntax error, queries too.
            errors = []
            if failure.code == "instrument-timeout":
                with contextlib.suppress(InstrumentError):
                    errors = self.recover()
            if errors:
                raise self._error_queue(said, errors) from failure
            raise
        wrong = [
            f"{setting.query}: asked {setting.asked}, answered {_plain(answer)}"
            for setting, answer in zip(settings, answers, strict=False)
            if not setting.agrees(answer)
        ]
        errors = self._collect_errors(answers[-1])
        if errors:
            raise self._error_queue(said, errors, "; ".join(wrong))
        if wrong:
            raise InstrumentError(
                "instrument-setting",
                self.name,
                "; ".join(wrong),
                "the instrument did not take the setting",
                "look at its front panel for a lock or a limit",
            )

    def command(self, message: str) -> None:
        """Send a command that has nothing to read back, and drain the error queue."""
        answers = self._ask(f"{message};:SYST:ERR?", 1)
        if errors := self._collect_errors(answers[0]):
            raise self._error_queue(message, errors)

    def drain_errors(self, after: str = "") -> None:
        """Empty the error queue; InstrumentError instrument-error-queue if anything was there."""
        if errors := self._collect_errors(None):
            raise self._error_queue(after, errors)

    def _collect_errors(self, first: str | None) -> list[ErrorEntry]:
        """All that the queue tells, within one timeout and never more than any queue holds."""
        errors: list[ErrorEntry] = []
        try:
            with self.transport.within():
                answer = first if first is not None else self.query("SYST:ERR?")
                while len(errors) < _MOST_ERRORS:
                    entry = self._entry(answer)
                    if entry.code == 0:
                        break
                    errors.append(entry)
                    answer = self.query("SYST:ERR?")
        except InstrumentError:
            if not errors:
                raise
        return errors

    def _entry(self, answer: str) -> ErrorEntry:
        try:
            return parse_error_entry(answer)
        except ScpiSyntaxError:
            self._stale = True
            raise InstrumentError(
                "instrument-garbage", self.name, f"SYST:ERR? answered {_shown(answer)}"
            ) from None

    def _error_queue(self, after: str, errors: list[ErrorEntry], also: str = "") -> InstrumentError:
        listed = ", ".join(str(error) for error in errors[:_SHOWN_ERRORS])
        if len(errors) > _SHOWN_ERRORS:
            listed += f" and {len(errors) - _SHOWN_ERRORS} more"
        if len(errors) == _MOST_ERRORS:
            listed += " (the queue does not empty)"
        what = f"reports {listed} after {after}" if after else f"reports {listed}"
        return InstrumentError(
            "instrument-error-queue", self.name, f"{what}; {also}" if also else what
        )

    # ------------------------------------------------------------- stale lines

    @contextlib.contextmanager
    def _line(self, timeout_s: float | None = None) -> Iterator[None]:
        """One exchange: fresh line before it, marked stale when it breaks off."""
        if self._stale:
            self.recover()
        try:
            with self.transport.within(timeout_s):
                self._refuse_unasked()
                yield
        except InstrumentError as error:
            self._stale = self._stale or error.code in _STALING
            raise
        except BaseException:
            self._stale = True  # interrupted: the answer may still be on its way
            raise

    def _refuse_unasked(self) -> None:
        unasked = self.transport.take_unasked()
        if unasked.strip():
            raise InstrumentError(
                "instrument-garbage",
                self.name,
                f"sent {len(unasked)} bytes that nobody asked for: {unasked[:40]!r}",
                "it answers twice, or another program talks to it through the same line",
            )

    def recover(self) -> list[ErrorEntry]:
        """Open the line afresh and make sure of who answers; what the error queue held."""
        self._stale = False
        begun = time.monotonic()
        left = max(_SHORTEST_RECOVERY_S, RECOVERY_S - self._recovering_s)
        try:
            with self.transport.within(left):
                self.transport.reopen()
                identity = self._identify_in_order()
                if self.identity is not None and identity.raw != self.identity.raw:
                    raise InstrumentError(
                        "instrument-identity",
                        self.name,
                        f"was {self.identity.raw!r} and is now {identity.raw!r}",
                        "it was exchanged for another one while the program ran",
                        "connect the one that the run began with, or start a new run",
                    )
                errors = self._collect_errors(None)
                self.transport.write(b"*CLS\n")
        except InstrumentError:
            self._stale = True
            self._recovering_s += time.monotonic() - begun
            raise
        self._recovering_s = 0.0
        return errors

    def _identify_in_order(self) -> Identity:
        """Who answers, late answers to earlier questions passed over.

        A serial line stays the same line when it is opened again, but answers
        keep the order of the questions.
        """
        self.transport.write(b"*IDN?\n")
        while True:
            line = self.transport.read_line().decode("latin-1").strip()
            try:
                return self._identity_in(line)
            except InstrumentError:
                continue

    def _read_text(self) -> str:
        line = self.transport.read_line()
        if any(byte < 0x20 and byte != 0x09 for byte in line):
            raise InstrumentError("instrument-garbage", self.name, f"answered {line[:40]!r}")
        return line.decode("latin-1").strip()


def _absolute(message: str) -> str:
    """With a leading colon, so that its place in a compound message does not matter."""
    return message if message[:1] in "*:" else f":{message}"


def _shown(answer: str) -> str:
    """An answer for a message: what cannot be printed escaped, what is long cut."""
    return ascii(answer) if len(answer) <= 80 else f"{answer[:80]!a}... ({len(answer)} bytes)"


def _plain(answer: str) -> str:
    """The same without quotes around it."""
    return _shown(answer.strip())[1:-1] if len(answer) <= 80 else _shown(answer)
