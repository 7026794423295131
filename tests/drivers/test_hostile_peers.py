"""Peers that misbehave in ways of their own; plain sockets, no code of the simulated instruments.

Whatever they do, `connect` and `settings` end with a named error within the
timeout and two seconds, or with the right answer.
"""

from __future__ import annotations

import contextlib
import os
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator

import pytest

from drivers.amplifier import ThorlabsMDT69x
from drivers.clock import VirtualClock
from drivers.digitizer import KeysightL4532A
from drivers.errors import InstrumentError
from drivers.scpi_instrument import RECOVERY_S, ScpiInstrument
from drivers.transport import open_transport

TIMEOUT_S = 0.15
PATIENT_S = 5.0  # for an answer that comes, however busy this machine
IDN = b"Agilent,L4532A,SIM7,1\n"
FINE = b'+0,"No error"\n'
Talk = Callable[[socket.socket, bytes], None]


class Peer:
    """Accepts any number of connections and hands every message to ``talk``."""

    def __init__(self, talk: Talk | None, greet: Callable[[socket.socket], None] | None) -> None:
        self._talk, self._greet = talk, greet
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"TCPIP::127.0.0.1::{self._listener.getsockname()[1]}::SOCKET"
        self.connections = 0
        self._over = threading.Event()
        self._threads = [threading.Thread(target=self._accept, daemon=True)]
        self._threads[0].start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while not self._over.is_set():
                connection, _ = self._listener.accept()
                self.connections += 1
                thread = threading.Thread(target=self._serve, args=(connection,), daemon=True)
                self._threads.append(thread)
                thread.start()

    def _serve(self, connection: socket.socket) -> None:
        with connection, contextlib.suppress(OSError):
            if self._greet is not None:
                self._greet(connection)
            kept = b""
            while self._talk is not None and (data := connection.recv(65536)):
                kept += data
                while b"\n" in kept:
                    message, _, kept = kept.partition(b"\n")
                    self._talk(connection, message)
            self._over.wait(0 if self._talk is None else 5)

    def close(self) -> None:
        self._over.set()
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for thread in self._threads:
            thread.join(1)


@pytest.fixture
def peer() -> Iterator[Callable[..., Peer]]:
    peers: list[Peer] = []

    def make(talk: Talk | None, greet: Callable[[socket.socket], None] | None = None) -> Peer:
        peers.append(Peer(talk, greet))
        return peers[-1]

    yield make
    for one in peers:
        one.close()


def named(act: Callable[[], object]) -> str:
    begun = time.monotonic()
    with pytest.raises(InstrumentError) as caught:
        act()
    assert time.monotonic() - begun < TIMEOUT_S + 2.0
    return caught.value.code


def answers(**table: bytes) -> Talk:
    """Answers by keyword: idn, err, opc, anything else."""

    def talk(connection: socket.socket, message: bytes) -> None:
        if b"*IDN?" in message:
            connection.sendall(table.get("idn", IDN))
        elif b"SYST:ERR?" in message:
            connection.sendall(table.get("err", FINE))
        elif b"?" in message:
            connection.sendall(table.get("other", b"1\n"))

    return talk


def drip(connection: socket.socket, message: bytes) -> None:
    """One byte at a time, so that no single read is late, and no end."""
    while True:
        connection.sendall(b"1")
        time.sleep(0.02)


def flood(connection: socket.socket, message: bytes) -> None:
    while True:
        connection.sendall(b"7" * 65536)


@pytest.mark.parametrize(
    ("talk", "codes"),
    [
        (None, {"instrument-hangup"}),
        (lambda connection, message: None, {"instrument-timeout"}),
        (drip, {"instrument-timeout"}),
        (flood, {"instrument-garbage"}),
        (lambda c, m: c.sendall(b"\x00" * 500_000 + b"\n"), {"instrument-garbage"}),
        (lambda c, m: c.sendall(b"A,L4532A\x00,SIM1,1\n"), {"instrument-garbage"}),
        (lambda c, m: c.sendall(b"\n\n\n\n"), {"instrument-garbage"}),
        (answers(idn=b"Agilent,L4532A,SIM7\n"), {"instrument-garbage"}),
        (answers(idn=b"Agilent,L4532A,SIM7,1," + b"x" * 5000 + b"\n"), {"instrument-garbage"}),
        (answers(idn=b"#15hello\n"), {"instrument-garbage"}),
        (answers(idn=b"Rigol\xe9,DG\xff,\xc3\xa9,1\n"), {"instrument-identity"}),
        (answers(idn=IDN + IDN), {"instrument-garbage"}),
        (answers(err=b'-100,"Command error"\n'), {"instrument-error-queue"}),
        (answers(err=b"fine, thank you\n"), {"instrument-garbage"}),
        (answers(err=b""), {"instrument-timeout"}),
        (answers(err=b"9" * 400 + b"\n"), {"instrument-error-queue", "instrument-garbage"}),
    ],
    ids=["closes-after-accept", "never-answers", "drips", "floods", "nul-bytes", "one-nul",
         "empty-lines", "three-fields", "endless-identity", "block-for-text", "non-ascii",
         "twice", "stuck-queue", "no-error-entry", "no-answer-to-the-queue", "huge-number"],
)  # fmt: skip
def test_no_one_is_connected_who_answers_like_that(peer, line, talk, codes):
    where = peer(talk).address

    def connect() -> None:
        transport = line(where, timeout_s=TIMEOUT_S)
        KeysightL4532A(transport).connect()

    assert named(connect) in codes


def test_a_peer_that_greets_is_not_taken_for_one_that_answers(peer, line):
    one = peer(answers(), greet=lambda c: c.sendall(b"Welcome to L4532A\r\nSCPI> "))
    transport = line(one.address, timeout_s=TIMEOUT_S)
    time.sleep(0.05)
    assert named(KeysightL4532A(transport).connect) == "instrument-garbage"


def test_a_queue_that_never_empties_is_not_asked_for_ever(peer, line):
    asked = []

    def talk(connection: socket.socket, message: bytes) -> None:
        asked.append(message)
        answers(err=b'-310,"System error"\n')(connection, message)

    link = ScpiInstrument(line(peer(talk).address, timeout_s=2.0))
    with pytest.raises(InstrumentError, match=r"21 more.*does not empty") as caught:
        link.drain_errors("something")
    assert caught.value.code == "instrument-error-queue"
    assert len(asked) <= 26


@pytest.mark.parametrize(
    ("block", "code"),
    [
        (b"#216" + bytes(16), "instrument-block"),  # nothing after it
        (b"#216" + bytes(15) + b"\n", "instrument-block"),  # the line feed is its last byte
        (b"#216" + bytes(40) + b"\n", "instrument-block"),
        (b"#9999999999" + bytes(16) + b"\n", "instrument-block"),
        (b"#900000016" + bytes(16) + b"\n", "instrument-garbage"),  # one digit short of nine
        (b"#0" + bytes(16) + b"\n", "instrument-garbage"),
        (b"#A16" + bytes(16) + b"\n", "instrument-garbage"),
        (b"#2-1" + bytes(16) + b"\n", "instrument-garbage"),
        (b"1.5,2.5\n", "instrument-garbage"),
        (b"\n", "instrument-timeout"),
        (b"#", "instrument-timeout"),
    ],
)
def test_a_block_with_a_wrong_header_is_never_data(peer, line, block, code):
    link = ScpiInstrument(line(peer(answers(other=block)).address, timeout_s=TIMEOUT_S))
    assert named(lambda: link.query_block("FETC?", 16)) == code
    link.transport.timeout_s = PATIENT_S
    assert link.query("*IDN?") == IDN.decode().strip()


def test_a_right_block_may_end_with_carriage_return_and_line_feed(peer, line):
    link = ScpiInstrument(line(peer(answers(other=b"#13abc\r\n")).address))
    assert link.query_block("FETC?", 3) == b"abc"
    assert link.query_block("FETC?", 3) == b"abc"


@pytest.mark.parametrize("pause", [0.0, 0.02])
def test_a_second_copy_of_an_answer_never_answers_the_next_question(peer, line, pause):
    """Also when it comes a little later, after the next question was sent."""
    count = iter(range(1000))

    def talk(connection: socket.socket, message: bytes) -> None:
        if b"*IDN?" in message:
            connection.sendall(IDN)
        elif b"SYST:ERR?" in message and b"VALUE" not in message:
            connection.sendall(FINE)
        else:
            answer = b"%d;%s" % (next(count), FINE)
            connection.sendall(answer)
            time.sleep(pause)
            connection.sendall(answer)

    link = ScpiInstrument(line(peer(talk).address, timeout_s=PATIENT_S))
    assert link.query_all("VALUE?", "SYST:ERR?")[0] == "0"
    link.transport.timeout_s = TIMEOUT_S
    if pause:
        # While the copy is still on its way it may be read, but only until the next look.
        with contextlib.suppress(InstrumentError):
            link.query_all("VALUE?", "SYST:ERR?")
    assert named(lambda: [link.drain_errors("x") for _ in range(2)]) == "instrument-garbage"


def test_a_peer_that_was_slow_once_is_asked_afresh_on_a_new_connection(peer, line):
    slow = iter([0.4])

    def talk(connection: socket.socket, message: bytes) -> None:
        if b"A?" in message:
            time.sleep(next(slow, 0.0))
            connection.sendall(b"late\n")
        else:
            answers(other=b"right\n")(connection, message)

    one = peer(talk)
    link = ScpiInstrument(line(one.address, timeout_s=TIMEOUT_S))
    assert named(lambda: link.query("A?")) == "instrument-timeout"
    link.transport.timeout_s = PATIENT_S
    assert link.query("B?") == "right"
    assert one.connections == 2


def test_all_attempts_to_get_a_line_back_share_one_allowance(peer, line):
    silent = threading.Event()

    def talk(connection: socket.socket, message: bytes) -> None:
        if not silent.is_set():
            answers()(connection, message)

    link = ScpiInstrument(line(peer(talk).address, timeout_s=PATIENT_S))
    link.connect(("L453",))
    link.transport.timeout_s = TIMEOUT_S
    silent.set()
    begun = time.monotonic()
    for _ in range(4):  # as a runner does that tries to make the bench safe
        with pytest.raises(InstrumentError):
            link.drain_errors()
    assert time.monotonic() - begun < TIMEOUT_S + RECOVERY_S + 3 * 0.25


def test_a_digitizer_that_cannot_say_how_much_it_holds_is_named(peer, line):
    digitizer = KeysightL4532A(line(peer(answers(other=b"lots\n")).address), VirtualClock())
    with pytest.raises(InstrumentError, match=r"SCO:MAX.*lots") as caught:
        digitizer.configure(5000, 100, {1: 128.0})
    assert caught.value.code == "instrument-garbage"


# ------------------------------------------------------------------ serial lines


@pytest.fixture
def terminal() -> Iterator[Callable[..., str]]:
    """``terminal(table)`` is a serial unit that answers a command as the table says."""
    opened: list[int] = []
    over = threading.Event()

    def make(table: dict[bytes, list[bytes]]) -> str:
        near, far = os.openpty()
        tty.setraw(far)
        opened.extend((near, far))
        kept = b""

        def serve() -> None:
            nonlocal kept
            with contextlib.suppress(OSError):
                while not over.is_set():
                    kept += os.read(near, 100)
                    while b"\r" in kept:
                        command, _, kept = kept.partition(b"\r")
                        told = table.get(command, [b""])
                        for piece in [told.pop(0) if len(told) > 1 else told[0]]:
                            if piece.startswith(b"wait"):
                                time.sleep(0.3)
                                piece = piece[4:]
                            os.write(near, piece)

        threading.Thread(target=serve, daemon=True).start()
        return os.ttyname(far)

    yield make
    over.set()
    for number in opened:
        os.close(number)


UNIT = {
    b"id?": [b"id?\r\rModel MDT694B\rVersion: 1.0\r> "],
    b"serial?": [b"serial?\rSIM1\r> "],
    b"vlimit?": [b"vlimit?\r[ 75]\r> "],
}


def unit(**more: list[bytes]) -> dict[bytes, list[bytes]]:
    return {**UNIT, **{f"{name}?".encode(): told for name, told in more.items()}}


@pytest.mark.parametrize(
    ("told", "code"),
    [
        (b"", "instrument-timeout"),
        (b"xvoltage?\r", "instrument-timeout"),
        (b"[75.0]\r", "instrument-timeout"),  # without a prompt
        (b"x" * 6000, "instrument-garbage"),
        (b"\x00\xff> ", "instrument-garbage"),
        (b"xvoltage?\r[75.0]\r> xvoltage?\r[75.0]\r> ", "instrument-garbage"),
        (b"vlimit?\r[ 75]\r> ", "instrument-garbage"),  # another question's answer
        (b"xvoltage?\r[7 5.0]\r> ", "instrument-garbage"),
        (b"xvoltage?\rCMD_NOT_DEFINED\r> ", "instrument-garbage"),
        (b"xvoltage?\r[60.0]\r> ", "instrument-setting"),
    ],
)
def test_an_amplifier_that_answers_like_that_is_not_used(terminal, line, told, code):
    transport = line(terminal(unit(xvoltage=[told])), timeout_s=TIMEOUT_S)
    assert named(ThorlabsMDT69x(transport).connect) == code


def test_a_late_number_of_the_amplifier_is_not_taken_for_another(terminal, line):
    """A terminal has no connections: what is late comes, whatever was opened again."""
    path = terminal(unit(xvoltage=[b"wait[60.0]\r> ", b"[75.0]\r> "]))  # a unit without echo
    transport = line(path, timeout_s=TIMEOUT_S)
    amplifier = ThorlabsMDT69x(transport)
    assert named(amplifier.set_voltage) == "instrument-timeout"
    transport.timeout_s = PATIENT_S
    assert amplifier.voltage_limit() == 75.0
    assert amplifier.set_voltage() == 75.0


def test_a_port_that_nobody_serves_is_refused_within_the_timeout():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    assert named(
        lambda: open_transport(f"TCPIP::127.0.0.1::{port}::SOCKET", "dac", TIMEOUT_S)
    ) == "instrument-refused"


def test_a_host_that_does_not_exist_is_refused():
    assert named(
        lambda: open_transport("TCPIP::no-such-host.invalid::5025::SOCKET", "dac", TIMEOUT_S)
    ) == "instrument-refused"
