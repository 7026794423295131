"""A transport whose far end is a recording.

What a driver sends is compared with what was sent then; what it reads is what came then, the
failures of the line included. Where a message differs, the tape goes on with the recorded one,
or finds the place where both agree again.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

from drivers.errors import InstrumentError
from drivers.transport import Observer
from piezo_rig.errors import PiezoRigError
from piezo_rig.guard import Unguarded
from piezo_rig.run_file.transcript import WireRecord

MOST_DIFFERENCES = 10
_LOOK_AHEAD = 30  # messages
_FAILURE = re.compile(r"([a-z]+(?:-[a-z]+)+): (.*)", re.DOTALL)
_SHOWN = 70
GUARD_EVENTS = (b"guard-lost: ", b"guard-took-over: ")


def _is_failure(record: WireRecord) -> bool:
    """Whether this is the line's failure, and not that it was opened or closed."""
    return record.direction == "event" and (
        _FAILURE.fullmatch(record.data.decode(errors="replace")) is not None
    )


class TapeEnds(PiezoRigError):
    """Nothing more can be compared: the recording is over, or the drivers went another way."""


class ReplayClock:
    """The bench's clock as it was: no earlier than the record that was passed last."""

    def __init__(self) -> None:
        self._now = 0.0

    def now(self) -> float:
        return self._now

    def sleep(self, seconds: float) -> float:
        self._now += max(0.0, seconds)
        return self._now

    def advance_to(self, instant: float) -> None:
        self._now = max(self._now, instant)


@dataclass
class Comparison:
    """What is found while the drivers run; one for all tapes of a session."""

    clock: ReplayClock = field(default_factory=ReplayClock)
    exchanges: int = 0
    differences: list[str] = field(default_factory=list)
    over: bool = False

    def differ(self, text: str) -> None:
        """Note a difference; TapeEnds when there are so many that more would say nothing."""
        self.differences.append(text)
        if len(self.differences) >= MOST_DIFFERENCES:
            self.differences.append("... and so on; the comparison ends here")
            self.end("too many differences")

    def end(self, why: str) -> None:
        self.over = True
        raise TapeEnds("replay-ends", why)


class TapeTransport:
    """`drivers.transport.Transport` over the records of one instrument.

    Parameters
    ----------
    instrument : its name, as in the transcript
    records : its records of one session, in order
    comparison : where differences are noted
    """

    address = "the recording"
    observer: Observer | None = None

    def __init__(
        self, instrument: str, records: Sequence[WireRecord], comparison: Comparison,
        timeout_s: float,
    ) -> None:
        self.instrument = instrument
        self.timeout_s = timeout_s
        self._records = records
        self._at = 0
        self._buffer = bytearray()
        self._comparison = comparison
        self._passed: int | None = None  # the recorded message that the last one stood in for

    # ------------------------------------------------------------- as a transport

    def write(self, data: bytes) -> None:
        self._must_go_on()
        self._pass_unread()
        self._match(data)
        record = self._next()
        if record is not None and b"?" not in data and _is_failure(record):
            self._fail(record)  # a message without an answer that did not get through

    def read_line(self) -> bytes:
        return self.read_until(b"\n").rstrip(b"\r\n")

    def read_until(self, terminator: bytes) -> bytes:
        while (end := self._buffer.find(terminator)) < 0:
            self._fill()
        return self._take(end + len(terminator))

    def read_exactly(self, count: int) -> bytes:
        while len(self._buffer) < count:
            self._fill()
        return self._take(count)

    def read_some(self) -> bytes:
        """What came at once, at least one byte."""
        if not self._buffer:
            self._fill()
        return self._take(len(self._buffer))

    def take_unasked(self) -> bytes:
        """What came without having been asked for, before the next message."""
        self._must_go_on()
        while (record := self._next()) is not None and record.direction != "out":
            if record.direction == "in":
                self._buffer += self._pass(record)
            elif _is_failure(record) or record.data.startswith(b"opened "):
                self._fail(record)  # opened: by the runner itself, after its guard was lost
            else:
                break
        return self._take(len(self._buffer))

    def check_guard(self) -> None:
        """Raise what became of the guard, where the runner found that out between two messages."""
        record = self._next()
        if record is not None and record.data.startswith(GUARD_EVENTS) and _is_failure(record):
            self._fail(record)

    @contextmanager
    def within(self, seconds: float | None = None) -> Iterator[None]:
        yield

    def close(self) -> None:
        self._buffer.clear()

    def reopen(self) -> None:
        """The line is opened again, as it was then."""
        self._must_go_on()
        self._buffer.clear()
        ahead = self._at
        while ahead < len(self._records) and self._records[ahead].direction != "out":
            record = self._records[ahead]
            ahead += 1
            if record.direction == "event" and record.data == b"reopened":
                self._at = ahead
                return
            if _is_failure(record):
                self._at = ahead - 1
                self._fail(record)
        self._comparison.differ(f"{self._where()}opens the line again, which it did not do then")

    # ------------------------------------------------------------------- the tape

    def _must_go_on(self) -> None:
        if self._comparison.over:
            raise TapeEnds("replay-ends", "the comparison is over")

    def _next(self) -> WireRecord | None:
        return self._records[self._at] if self._at < len(self._records) else None

    def _pass(self, record: WireRecord) -> bytes:
        self._at += 1
        self._comparison.clock.advance_to(record.time_s)
        return record.data

    def _take(self, count: int) -> bytes:
        data = bytes(self._buffer[:count])
        del self._buffer[:count]
        return data

    def _fill(self) -> None:
        """More of what came then; the failure of the line, where that is what came."""
        self._must_go_on()
        record = self._next()
        if record is None:
            if self._is_complete and not self._comparison.differences:
                self._comparison.differences.append(
                    f"{self._where()}waits for an answer after the end of the recording"
                )
            self._comparison.end("the recording ends here")
        elif record.direction == "in":
            self._buffer += self._pass(record)
        elif record.direction == "event":
            self._fail(record)
        else:
            self._comparison.differences.append(
                f"{self._where()}waits for an answer that was not read then"
            )
            self._comparison.end("no answer was recorded")

    def _fail(self, record: WireRecord) -> None:
        """Raise what the line did then; other events (opened, closed) are passed over."""
        found = _FAILURE.fullmatch(record.data.decode(errors="replace"))
        if found is None:
            self._pass(record)
            return
        self._pass(record)
        raise InstrumentError(found.group(1), self.instrument, found.group(2))

    def _pass_unread(self) -> None:
        """On to the next message that was sent; what is left of an answer is noted."""
        left = len(self._buffer)
        self._buffer.clear()
        while (record := self._next()) is not None and record.direction != "out":
            left += len(record.data) if record.direction == "in" else 0
            self._pass(record)
        if left:
            self._comparison.differ(f"{self._where()}leaves {left} bytes unread that it read then")

    def _match(self, data: bytes) -> None:
        """Pass the recorded message that this one is; note where it is none or another."""
        if self._passed is not None and self._records[self._passed].data == data:
            # The one before stood in for nothing: it is new, and this is the recorded one.
            self._at, self._passed = self._passed, None
        record = self._next()
        if record is None:
            if self._comparison.differences or not self._is_complete:
                self._comparison.end("the recording ends here")
            self._comparison.differences.append(
                f"{self._where()}sends {shown(data)} after the last recorded message"
            )
            self._comparison.end("the recording ends here")
            return
        if record.data == data:
            self._comparison.exchanges += 1
            self._passed = None
            self._pass(record)
            return
        ahead = [
            i for i in range(self._at + 1, len(self._records))
            if self._records[i].direction == "out"
        ][:_LOOK_AHEAD]
        found = next((i for i in ahead if self._records[i].data == data), None)
        if found is not None:
            skipped = 1 + sum(i < found for i in ahead)
            where, self._at = self._where(), found
            self._pass(self._records[found])
            self._comparison.exchanges += 1
            self._comparison.differ(
                f"{where}no longer sends {shown(record.data)}"
                + (f" and {skipped - 1} more messages" if skipped > 1 else "")
            )
            return
        self._passed = self._at
        where = self._where()
        self._pass(record)
        self._comparison.differ(f"{where}sends {shown(data)} where {shown(record.data)} was sent")

    _is_complete = True

    def may_break_off(self) -> None:
        """The recording was broken off: its end is no difference."""
        self._is_complete = False

    def left(self) -> int:
        """Messages that were sent then and not now."""
        return sum(r.direction == "out" for r in self._records[self._at :])

    def _where(self) -> str:
        record = self._next() or (self._records[-1] if self._records else None)
        at = f" at {record.time_s:.3f} s" if record is not None else ""
        return f"{self.instrument}{at}: "


class TapeKeeper(Unguarded):
    """The guard as it was: there, until the record of the generator's line says otherwise."""

    def __init__(self, generator: TapeTransport) -> None:
        self._generator = generator

    def check(self) -> None:
        self._generator.check_guard()


def shown(data: bytes) -> str:
    """A message for a terminal: printable, and short."""
    text = data[:_SHOWN].decode("latin-1").strip()
    printable = "".join(c if c.isascii() and c.isprintable() else "." for c in text)
    return f"'{printable}'" + (f"... ({len(data)} bytes)" if len(data) > _SHOWN else "")
