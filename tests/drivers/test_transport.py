"""How a line fails, and what the drivers make of it."""

from __future__ import annotations

import os
import socket
import threading
import time
import tty

import pytest

from drivers.errors import InstrumentError
from drivers.scpi_instrument import ScpiInstrument, Setting
from drivers.transport import open_transport


@pytest.fixture
def peer():
    """``peer(serve)`` listens and runs ``serve(connection)`` once per connection."""
    listener = socket.create_server(("127.0.0.1", 0))
    threads = []

    def start(*serves):
        def run():
            for serve in serves:
                connection, _ = listener.accept()
                with connection:
                    serve(connection)

        threads.append(threading.Thread(target=run, daemon=True))
        threads[-1].start()
        return f"TCPIP::127.0.0.1::{listener.getsockname()[1]}::SOCKET"

    yield start
    for thread in threads:
        thread.join(5)
    listener.close()


def answers(table):
    """A peer that knows some messages and is silent at the others."""

    def serve(connection):
        kept = b""
        while data := connection.recv(4096):
            kept += data
            while b"\n" in kept:
                message, _, kept = kept.partition(b"\n")
                reply = table.get(message.decode())
                if reply is not None:
                    connection.sendall(reply)

    return serve


IDENTIFIED = {"*IDN?": b"Keysight,33521B,SIM9,1\n", "SYST:ERR?": b'+0,"No error"\n'}


def test_a_port_where_nothing_listens_is_refused_at_once():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    begun = time.monotonic()
    with pytest.raises(InstrumentError) as refused:
        open_transport(f"TCPIP::127.0.0.1::{port}::SOCKET", "digitizer", timeout_s=5)
    assert refused.value.code == "instrument-refused"
    assert refused.value.instrument == "digitizer"
    assert time.monotonic() - begun < 2


def test_a_serial_port_that_does_not_exist_is_refused():
    with pytest.raises(InstrumentError) as refused:
        open_transport("/dev/there-is-no-such-port", "amplifier")
    assert refused.value.code == "instrument-refused"


def test_a_peer_that_hangs_up_is_noticed_long_before_the_timeout(peer, line):
    def hang_up(connection):
        connection.recv(100)
        connection.sendall(b"half an ans")

    transport = line(peer(hang_up), timeout_s=20)
    begun, spent = time.monotonic(), time.process_time()
    transport.write(b"*IDN?\n")
    with pytest.raises(InstrumentError) as failure:
        transport.read_line()
    assert failure.value.code == "instrument-hangup"
    assert time.monotonic() - begun < 2
    assert time.process_time() - spent < 0.5


def test_a_peer_that_hangs_up_within_a_block_is_noticed(peer, line):
    def hang_up(connection):
        connection.recv(100)
        connection.sendall(b"#9000100000" + bytes(5000))

    link = ScpiInstrument(line(peer(hang_up), timeout_s=20))
    begun = time.monotonic()
    with pytest.raises(InstrumentError) as failure:
        link.query_block("FETC?")
    assert failure.value.code == "instrument-hangup"
    assert time.monotonic() - begun < 2


def test_silence_is_a_timeout(peer, line):
    transport = line(peer(answers({})), timeout_s=0.2)
    transport.write(b"*IDN?\n")
    with pytest.raises(InstrumentError) as failure:
        transport.read_line()
    assert failure.value.code == "instrument-timeout"


def test_a_late_answer_is_never_taken_for_the_next_one(peer, line):
    seen = []

    def slow(connection):
        connection.recv(100)
        time.sleep(0.3)
        connection.sendall(b"the late one\n")

    def second(connection):
        seen.append("reconnected")
        answers({**IDENTIFIED, "B?": b"right\n"})(connection)

    link = ScpiInstrument(line(peer(slow, second), timeout_s=0.1))
    with pytest.raises(InstrumentError) as failure:
        link.query("A?")
    assert failure.value.code == "instrument-timeout"
    time.sleep(0.4)
    link.transport.timeout_s = 2
    assert link.query("B?") == "right"
    assert seen == ["reconnected"]
    link.close()


def test_another_instrument_after_a_reconnection_is_an_identity_error(peer, line):
    other = {**IDENTIFIED, "*IDN?": b"Keysight,33521B,SIM10,1\n"}
    link = ScpiInstrument(line(peer(answers(IDENTIFIED), answers(other)), timeout_s=0.3))
    link.connect(["335"])
    with pytest.raises(InstrumentError):
        link.query("silence?")
    link.transport.timeout_s = 5.0
    with pytest.raises(InstrumentError) as failure:
        link.query("*IDN?")
    assert failure.value.code == "instrument-identity"
    link.close()


@pytest.mark.parametrize(
    ("reply", "code"),
    [
        (b"\x00\x01\x02 noise\n", "instrument-garbage"),
        (b"hello\n", "instrument-garbage"),
        (b"Rigol,DG1022,SIM1,1\n", "instrument-identity"),
    ],
)
def test_something_else_at_the_address_is_not_accepted(peer, line, reply, code):
    link = ScpiInstrument(line(peer(answers({"*IDN?": reply}))))
    with pytest.raises(InstrumentError) as failure:
        link.connect(["335"])
    assert failure.value.code == code
    link.close()


def test_a_setting_that_was_not_taken_names_instrument_setting_asked_and_answered(peer, line):
    message = ":VOLT:HIGH 2;:VOLT:HIGH?;:SYST:ERR?"
    table = {message: b'+1.5E+00;+0,"No error"\n'}
    link = ScpiInstrument(line(peer(answers(table))))
    with pytest.raises(InstrumentError, match=r"instrument: VOLT:HIGH.*asked 2.*answered \+1\.5E"):
        link.apply(Setting.number("VOLT:HIGH", 2.0))
    link.close()


def test_answers_on_separate_lines_are_understood(peer, line):
    table = {":A?;:B?": b"1\n2\n"}
    link = ScpiInstrument(line(peer(answers(table))))
    assert link.query_all("A?", "B?") == ["1", "2"]
    link.close()


def test_every_error_in_the_queue_is_told(peer, line):
    queue = iter([b'-222,"Data out of range"\n', b'+786,"exists"\n', b'+0,"No error"\n'])

    def serve(connection):
        while connection.recv(4096):
            connection.sendall(next(queue))

    link = ScpiInstrument(line(peer(serve)))
    with pytest.raises(InstrumentError, match=r"-222.*\+786.*after DATA"):
        link.drain_errors("DATA")
    link.close()


def test_the_observer_sees_both_directions(peer, line):
    transcript = []
    transport = line(
        peer(answers({"*IDN?": b"me\n"})), observer=lambda way, data: transcript.append((way, data))
    )
    transport.write(b"*IDN?\n")
    transport.read_line()
    assert ("out", b"*IDN?\n") in transcript
    assert ("in", b"me\n") in transcript
    transport.close()


def test_a_hundred_small_exchanges_are_not_slowed_by_nagle(bench, line):
    transport = line(bench.addresses["waveform_dac"])
    begun = time.monotonic()
    for _ in range(100):
        transport.write(b"*CLS\n")  # two short writes in a row are what Nagle holds back
        transport.write(b"*ESR?\n")
        transport.read_line()
    assert time.monotonic() - begun < 2  # held back they take over 4 s


def test_a_long_block_of_line_feeds_arrives_whole(peer, line):
    payload = b"\n" * 200_000

    def serve(connection):
        connection.recv(100)
        connection.sendall(b"#6200000" + payload + b"\n")

    link = ScpiInstrument(line(peer(serve)))
    assert link.query_block("FETC?") == payload
    link.close()


def test_a_serial_line_carries_a_line_both_ways(line):
    near, far = os.openpty()
    tty.setraw(far)
    transport = line(os.ttyname(far))
    transport.write(b"id?\r")
    assert os.read(near, 100) == b"id?\r"
    os.write(near, b"MDT694B\r> ")
    assert transport.read_until(b"> ") == b"MDT694B\r> "
    transport.timeout_s = 0.1
    with pytest.raises(InstrumentError) as failure:
        transport.read_line()
    assert failure.value.code == "instrument-timeout"
    transport.close()
    os.close(near)
    os.close(far)
