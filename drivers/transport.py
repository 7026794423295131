"""Bytes out, bytes in: sockets and USB through PyVISA, serial lines through pyserial.

A transport knows nothing of SCPI. It turns every way in which a line can fail
into an `InstrumentError` with a stable code, and shows each transfer to an
observer, which keeps the wire transcript.

PyVISA's pure Python backend has habits that matter here: a refused port opens
without complaint; a peer that hangs up during a read spins until the timeout;
writes ignore the timeout; Nagle's algorithm delays the second of two short
writes by about 40 ms. `VisaTransport` reaches the socket behind the session to
prevent all four, and falls back to the plain VISA calls where it finds none.
USB has never been tried on hardware.
"""

from __future__ import annotations

import abc
import contextlib
import functools
import re
import select
import socket
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any, Protocol

from drivers.errors import InstrumentError

Observer = Callable[[str, bytes], None]
"""Called with ``out``, ``in`` or ``event`` and the bytes concerned."""

_CHUNK = 1 << 16
_WRITE_CHUNK = 4096  # what pyvisa-py sends at once
_LONGEST_LINE = 1 << 16


class Transport(Protocol):
    """A line to one instrument.

    Every method may raise InstrumentError: instrument-refused,
    instrument-timeout, instrument-hangup or instrument-garbage. Each has
    ``timeout_s`` for itself, unless it stands inside `within`.
    """

    address: str
    instrument: str
    timeout_s: float
    observer: Observer | None

    def write(self, data: bytes) -> None: ...

    def read_line(self) -> bytes:
        """One line, without its line feed and carriage return."""
        ...

    def read_until(self, terminator: bytes) -> bytes:
        """Everything up to and including ``terminator``."""
        ...

    def read_exactly(self, count: int) -> bytes: ...

    def read_some(self) -> bytes:
        """What there is, at least one byte."""
        ...

    def take_unasked(self) -> bytes:
        """What has come without being read, taken off the line; does not wait."""
        ...

    def within(self, seconds: float | None = None) -> AbstractContextManager[None]:
        """All that is done inside has this long together (``timeout_s`` when None).

        An instrument that sends a byte now and then cannot stretch it, and an
        outer `within` cannot be exceeded by an inner one.
        """
        ...

    def close(self) -> None: ...

    def reopen(self) -> None:
        """Close and open again.

        Whatever was on its way over a socket is lost; a serial line has no
        connections, and an answer that is late may still come.
        """
        ...


class Deadlines:
    """`Transport.within` for a transport that asks ``until()`` or ``left_s()`` when it waits."""

    timeout_s: float
    _deadline: float | None = None
    allowed_s = 0.0
    """How long the latest wait might have taken, for messages."""

    @contextlib.contextmanager
    def within(self, seconds: float | None = None) -> Iterator[None]:
        before = self._deadline, self.allowed_s
        allowed = self.timeout_s if seconds is None else seconds
        deadline = time.monotonic() + allowed
        if before[0] is None or deadline < before[0]:
            self._deadline, self.allowed_s = deadline, allowed
        try:
            yield
        finally:
            self._deadline, self.allowed_s = before

    def until(self) -> float:
        """When what is begun now has to be done, on ``time.monotonic``."""
        if self._deadline is not None:
            return self._deadline
        self.allowed_s = self.timeout_s
        return time.monotonic() + self.timeout_s

    def left_s(self) -> float:
        """The same as seconds from now, 0 when they are over."""
        return max(0.0, self.until() - time.monotonic())


class BufferedTransport(Deadlines, abc.ABC):
    """Line and count framing over a subclass's `_receive`, `_send`, `_open` and `_shut`."""

    def __init__(
        self, address: str, instrument: str, timeout_s: float, observer: Observer | None = None
    ) -> None:
        self.address = address
        self.instrument = instrument
        self.timeout_s = timeout_s
        self.observer = observer
        self._buffer = bytearray()
        self._is_open = False
        self._open()
        self._is_open = True
        self._observe("event", b"opened " + address.encode())

    @abc.abstractmethod
    def _open(self) -> None: ...

    @abc.abstractmethod
    def _shut(self) -> None: ...

    @abc.abstractmethod
    def _send(self, data: bytes, deadline: float) -> None: ...

    @abc.abstractmethod
    def _receive(self, wanted: int, deadline: float) -> bytes:
        """At least one byte before the deadline, or an InstrumentError."""

    @abc.abstractmethod
    def _waiting(self) -> bytes:
        """What can be had without waiting; empty too where that cannot be told."""

    def write(self, data: bytes) -> None:
        self._must_be_open()
        self._observe("out", data)
        self._send(data, self.until())

    def read_line(self) -> bytes:
        return self.read_until(b"\n").rstrip(b"\r\n")

    def read_until(self, terminator: bytes) -> bytes:
        deadline = self.until()
        begin = 0
        while (end := self._buffer.find(terminator, begin)) < 0:
            if len(self._buffer) > _LONGEST_LINE:
                raise self._error("instrument-garbage", "sent a line that never ends")
            begin = max(0, len(self._buffer) - len(terminator) + 1)
            self._fill(1, deadline)
        return self._take(end + len(terminator))

    def read_exactly(self, count: int) -> bytes:
        deadline = self.until()
        while len(self._buffer) < count:
            self._fill(count - len(self._buffer), deadline)
        return self._take(count)

    def read_some(self) -> bytes:
        if not self._buffer:
            self._fill(1, self.until())
        return self._take(len(self._buffer))

    def take_unasked(self) -> bytes:
        self._must_be_open()
        self._buffer += self._waiting()
        return self._take(len(self._buffer)) if self._buffer else b""

    def close(self) -> None:
        if self._is_open:
            self._is_open = False
            self._shut()
            self._observe("event", b"closed")
        self._buffer.clear()

    def reopen(self) -> None:
        self.close()
        self._open()
        self._is_open = True
        self._observe("event", b"reopened")

    def _fill(self, wanted: int, deadline: float) -> None:
        self._must_be_open()
        if time.monotonic() > deadline:
            raise self._timed_out()  # however much there still is to be had
        self._buffer += self._receive(wanted, deadline)

    def _take(self, count: int) -> bytes:
        data = bytes(self._buffer[:count])
        del self._buffer[:count]
        self._observe("in", data)
        return data

    def _must_be_open(self) -> None:
        if not self._is_open:
            raise self._error("instrument-hangup", "the line is closed")

    def _observe(self, direction: str, data: bytes) -> None:
        if self.observer is not None:
            self.observer(direction, data)

    def _error(self, code: str, what: str, cause: str = "", remedy: str = "") -> InstrumentError:
        self._observe("event", f"{code}: {what}".encode())
        return InstrumentError(code, self.instrument, f"{what} ({self.address})", cause, remedy)

    def _refused(self, detail: object) -> InstrumentError:
        return self._error(
            "instrument-refused",
            f"cannot connect: {detail}",
            "the instrument is switched off, or its address in the rig's config is wrong",
            "switch it on, check the cable and the address",
        )

    def _timed_out(self) -> InstrumentError:
        have = f", after {len(self._buffer)} bytes" if self._buffer else ""
        return self._error(
            "instrument-timeout", f"did not answer within {self.allowed_s:.3g} s{have}"
        )

    def _hung_up(self, detail: object) -> InstrumentError:
        return self._error(
            "instrument-hangup",
            f"hung up: {detail}",
            "the instrument was switched off or reset, the cable pulled, "
            "or another program took the line",
        )


@functools.lru_cache(maxsize=1)
def _resource_manager() -> Any:
    import pyvisa

    return pyvisa.ResourceManager("@py")


class VisaTransport(BufferedTransport):
    """A TCP socket (``TCPIP::host::port::SOCKET``) or a USB instrument, through PyVISA."""

    def _open(self) -> None:
        manager = _resource_manager()
        self._socket: socket.socket | None = None
        self._behind: Any = None
        try:
            if host := re.match(r"TCPIP\d*::([^:]+)::", self.address, re.IGNORECASE):
                socket.gethostbyname(host.group(1))  # pyvisa-py leaves a socket open if this fails
            # PyVISA raises its own errors, pyvisa-py bare exceptions and OSError.
            self._resource = manager.open_resource(
                self.address,
                open_timeout=max(1, int(1000 * self.left_s())),
                timeout=int(1000 * self.timeout_s),
            )
        except Exception as error:
            raise self._refused(error) from error
        self._library = manager.visalib
        self._session = self._resource.session
        self._find_socket()

    def _find_socket(self) -> None:
        with contextlib.suppress(Exception):
            behind = self._library.sessions[self._session]
            # It reads ahead of what it is asked for, so that the socket may look empty.
            if isinstance(behind.interface, socket.socket) and len(behind._pending_buffer) == 0:
                self._behind = behind
                self._socket = behind.interface
        if self._socket is None:
            return
        failure = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if failure:
            self._shut()
            raise self._refused(OSError(failure, "connection refused"))
        with contextlib.suppress(OSError):
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with contextlib.suppress(OSError, AttributeError):
            # A blocking send would otherwise wait for ever on a peer that stopped reading.
            limit = struct.pack("ll", int(self.timeout_s), int(self.timeout_s % 1 * 1e6))
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, limit)

    def _shut(self) -> None:
        self._socket = self._behind = None
        with contextlib.suppress(Exception):
            self._resource.close()

    def _send(self, data: bytes, deadline: float) -> None:
        if self._socket is None:
            self._visa_write(data)
            return
        for begin in range(0, len(data), _WRITE_CHUNK):
            left = deadline - time.monotonic()
            if left <= 0 or not select.select([], [self._socket], [], left)[1]:
                raise self._timed_out()
            self._visa_write(data[begin : begin + _WRITE_CHUNK])

    def _visa_write(self, data: bytes) -> None:
        try:
            written, status = self._library.write(self._session, data)
        except BlockingIOError as error:
            raise self._timed_out() from error
        except ConnectionRefusedError as error:
            raise self._refused(error) from error
        except Exception as error:
            raise self._hung_up(error) from error
        if written != len(data) or int(status) < 0:
            raise self._timed_out()

    def _receive(self, wanted: int, deadline: float) -> bytes:
        if self._socket is None:
            return self._visa_read(1 if "SOCKET" in self.address.upper() else _CHUNK, deadline)
        if ahead := len(self._behind._pending_buffer):
            return self._visa_read(ahead, deadline)
        if wanted < _WRITE_CHUNK:
            self._acknowledge_at_once(self._socket)
        left = deadline - time.monotonic()
        if left <= 0 or not select.select([self._socket], [], [], left)[0]:
            raise self._timed_out()
        try:
            # An empty peek is a hang-up; pyvisa-py would take it for "nothing yet".
            waiting = len(self._socket.recv(_CHUNK, socket.MSG_PEEK))
        except OSError as error:
            raise self._hung_up(error) from error
        if waiting == 0:
            raise self._hung_up("the connection was closed at the other end")
        return self._visa_read(waiting, deadline)

    def _waiting(self) -> bytes:
        if self._socket is None:
            return self._visa_waiting()
        if ahead := len(self._behind._pending_buffer):
            return self._visa_read(ahead, time.monotonic())
        with contextlib.suppress(OSError):
            if select.select([self._socket], [], [], 0)[0]:
                waiting = len(self._socket.recv(_CHUNK, socket.MSG_PEEK))
                return self._visa_read(waiting, time.monotonic()) if waiting else b""
        return b""

    def _visa_waiting(self) -> bytes:
        if "SOCKET" not in self.address.upper():
            return b""  # over USB nothing comes that was not asked for
        found = b""
        with contextlib.suppress(InstrumentError):  # a timeout: there is nothing more
            while True:
                found += self._visa_read(1, time.monotonic() + 0.001)
        return found

    @staticmethod
    def _acknowledge_at_once(line: socket.socket) -> None:
        """Spare a peer that has Nagle's algorithm on the wait between two short answers.

        The system forgets this option, so it is set before every read.
        """
        option = getattr(socket, "TCP_QUICKACK", None)  # Linux only
        if option is not None:
            with contextlib.suppress(OSError):
                line.setsockopt(socket.IPPROTO_TCP, option, 1)

    def _visa_read(self, count: int, deadline: float) -> bytes:
        import pyvisa

        if self._socket is None:  # otherwise the bytes are already here
            self._resource.timeout = max(1, int(1000 * (deadline - time.monotonic())))
        try:
            with self._resource.ignore_warning(pyvisa.constants.StatusCode.success_max_count_read):
                data, _ = self._library.read(self._session, count)
        except pyvisa.errors.VisaIOError as error:
            if error.error_code == pyvisa.constants.StatusCode.error_timeout:
                raise self._timed_out() from error
            raise self._hung_up(error) from error
        except Exception as error:
            raise self._hung_up(error) from error
        if not data:
            raise self._timed_out()
        return bytes(data)


class SerialTransport(BufferedTransport):
    """A serial line or a pseudo terminal, 115200 8N1, through pyserial."""

    def _open(self) -> None:
        import serial

        try:
            self._port = serial.Serial(
                self.address,
                baudrate=115200,
                bytesize=serial.EIGHTBITS,
                parity=serial.PARITY_NONE,
                stopbits=serial.STOPBITS_ONE,
                timeout=self.timeout_s,
                write_timeout=self.timeout_s,
            )
        except Exception as error:  # of pyserial, the system, and termios, which is neither
            raise self._refused(error) from error

    def _shut(self) -> None:
        with contextlib.suppress(Exception):
            self._port.close()

    def _send(self, data: bytes, deadline: float) -> None:
        import serial

        try:
            self._port.write(data)
        except serial.SerialTimeoutException as error:
            raise self._timed_out() from error
        except Exception as error:
            raise self._hung_up(error) from error

    def _receive(self, wanted: int, deadline: float) -> bytes:
        try:
            self._port.timeout = max(0.0, deadline - time.monotonic())
            data = self._port.read(max(1, self._port.in_waiting))
        except Exception as error:
            raise self._hung_up(error) from error
        if not data:
            raise self._timed_out()
        return bytes(data)

    def _waiting(self) -> bytes:
        try:
            return bytes(self._port.read(self._port.in_waiting))
        except Exception as error:
            raise self._hung_up(error) from error


def open_transport(
    address: str, instrument: str, timeout_s: float = 5.0, observer: Observer | None = None
) -> Transport:
    """Open the line that an address of the rig's config names.

    ``TCPIP::...`` and ``USB...`` go through PyVISA; a device path, ``COM3`` or
    ``ASRL...`` through pyserial; ``Dev1/ao0`` is a card of this computer.
    InstrumentError instrument-refused when nothing is there.
    """
    from drivers.nidaqmx_card import CardTransport, is_card

    if is_card(address):
        return CardTransport(address, instrument, timeout_s, observer)
    if re.match(r"(TCPIP|USB|GPIB)\d*::", address, re.IGNORECASE):
        return VisaTransport(address, instrument, timeout_s, observer)
    port = re.sub(r"^ASRL|::INSTR$", "", address, flags=re.IGNORECASE)
    return SerialTransport(port, instrument, timeout_s, observer)
