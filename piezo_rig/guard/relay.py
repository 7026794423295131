"""The runner's line to the generator: by way of the guard, or straight when the guard is gone."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable

from drivers.errors import InstrumentError
from drivers.transport import Deadlines, Observer, Transport, open_transport
from piezo_rig.guard import frames
from piezo_rig.guard.frames import Kind
from piezo_rig.guard.orders import Report

_GRACE_S = 10.0  # the guard answers this much later than the line's own timeout at most
_START_S = 30.0  # a slow computer starts the guard


class RelayTransport(Deadlines):
    """A `drivers.transport.Transport` whose far end is in the guard's hands.

    A guard that is gone, or does not answer, is an InstrumentError, once:
    guard-lost, or guard-took-over when it had reason to act. From then on the
    line is the runner's own, so that the runner can come to rest by itself.

    Parameters
    ----------
    line : socket to the guard
    address, instrument, timeout_s, observer : as of any transport
    lose : called when the guard is given up; ends it, so that it lets go of the line
    """

    def __init__(
        self, line: socket.socket, address: str, instrument: str, timeout_s: float,
        observer: Observer | None, lose: Callable[[], None],
    ) -> None:
        self.address = address
        self.instrument = instrument
        self.timeout_s = timeout_s
        self.observer = observer
        self._line: socket.socket | None = line
        self._lose = lose
        self._straight: Transport | None = None
        self._ask(Kind.OPEN, extra_s=_START_S)
        self._observe("event", b"opened " + address.encode())

    # ---------------------------------------------------------- as a transport

    def write(self, data: bytes) -> None:
        if self._line is None:
            self._own().write(data)
            return
        self._observe("out", data)
        self._ask(Kind.WRITE, data)

    def read_line(self) -> bytes:
        return self.read_until(b"\n").rstrip(b"\r\n")

    def read_until(self, terminator: bytes) -> bytes:
        if self._line is None:
            return self._own().read_until(terminator)
        data = self._ask(Kind.UNTIL, terminator)
        self._observe("in", data)
        return data

    def read_exactly(self, count: int) -> bytes:
        if self._line is None:
            return self._own().read_exactly(count)
        data = self._ask(Kind.EXACTLY, str(count).encode())
        self._observe("in", data)
        return data

    def read_some(self) -> bytes:
        if self._line is None:
            return self._own().read_some()
        data = self._ask(Kind.SOME)
        self._observe("in", data)
        return data

    def take_unasked(self) -> bytes:
        if self._line is None:
            return self._own().take_unasked()
        data = self._ask(Kind.UNASKED)
        if data:
            self._observe("in", data)
        return data

    def reopen(self) -> None:
        if self._line is None:
            self._own().reopen()
            return
        self._ask(Kind.REOPEN)
        self._observe("event", b"reopened")

    def close(self) -> None:
        """Close a line of its own; the guard's is closed when the guard is told that all is over.
        """
        if self._straight is not None:
            self._straight.close()

    # ---------------------------------------------------------------- the guard

    def finish(self) -> bool:
        """Tell the guard that all is over; whether it heard."""
        if self._line is None:
            return False
        try:
            self._ask(Kind.FINISHED)
        except InstrumentError:
            return False
        return True

    def _ask(self, kind: Kind, payload: bytes = b"", extra_s: float = 0.0) -> bytes:
        line = self._line
        assert line is not None
        try:
            left_s = self.left_s()
            line.settimeout(left_s + _GRACE_S + extra_s)
            frames.send(line, kind, left_s, payload)
        except OSError:
            raise self._gone() from None
        return self._answer()

    def _answer(self) -> bytes:
        assert self._line is not None
        try:
            frame = frames.receive(self._line)
        except OSError:
            frame = None
        if frame is None or frame[0] == Kind.TAKEN:
            raise self._gone(frame)
        kind, _, payload = frame
        if kind == Kind.FAILED:
            error = frames.unpack_error(payload, self.instrument)
            self._observe("event", f"{error.code}: {error.what}".encode())
            raise error
        return payload

    def _gone(self, frame: tuple[Kind, float, bytes] | None = None) -> InstrumentError:
        """What became of the guard; from now on the line is the runner's own."""
        line, self._line = self._line, None
        assert line is not None
        with contextlib.suppress(OSError):
            line.settimeout(0.2)
            while frame is None or frame[0] != Kind.TAKEN:
                frame = frames.receive(line)  # it may have said something before it went
                if frame is None:
                    break
        line.close()
        self._lose()
        if frame is not None and frame[0] == Kind.TAKEN:
            report = Report.from_json(frame[2].decode())
            error = InstrumentError(
                "guard-took-over", self.instrument, report.sentence(),
                "this program stood still: the computer slept or was overloaded, a disk hung, "
                "or somebody stopped it",
                "go on with 'piezo-rig run --resume'",
            )
        else:
            error = InstrumentError(
                "guard-lost", self.instrument, "the guard process is gone or does not answer",
                "somebody or the system ended it (out of memory?)",
                "go on with 'piezo-rig run --resume'; a run is not played without its guard",
            )
        self._observe("event", f"{error.code}: {error.what}".encode())
        return error

    def _own(self) -> Transport:
        if self._straight is None:
            self._straight = open_transport(
                self.address, self.instrument, self.timeout_s, self.observer
            )
        self._straight.timeout_s = self.left_s()
        return self._straight

    def _observe(self, direction: str, data: bytes) -> None:
        if self.observer is not None:
            self.observer(direction, data)
