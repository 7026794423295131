"""The drivers against a SCPI server that answers in its own way.

The server is a table of settings on a plain socket; it shares no code with the
simulated instruments. It answers long mnemonics, ON and OFF, short numbers and
waveform names with a folder, and puts every answer on a line of its own.
"""

from __future__ import annotations

import socket
import threading

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.digitizer import KeysightL4532A
from drivers.errors import InstrumentError
from drivers.waveform_dac import Keysight33500B

GENERATOR = {
    "OUTP1": "OFF",
    "OUTP1:LOAD": "50",
    "SOUR1:FUNC": "SIN",
    "SOUR1:FUNC:ARB": '"INT:\\BUILTIN\\EXP_RISE.ARB"',
    "SOUR1:FUNC:ARB:SRAT": "40000",
    "SOUR1:FUNC:ARB:FILT": "STEP",
    "SOUR1:BURS:STAT": "OFF",
    "SOUR1:BURS:MODE": "TRIGGERED",
    "SOUR1:BURS:NCYC": "1",
    "TRIG1:SOUR": "IMMEDIATE",
    "OUTP:TRIG": "OFF",
    "OUTP:TRIG:SLOP": "POSITIVE",
    "FORM:BORD": "NORMAL",
}
LONG = {"SWAP": "swapped", "TRIG": "Triggered", "POS": "positive", "ON": "ON", "EXT": "EXTERNAL"}


class OwnWay:
    """One connection after the other, one message after the other."""

    def __init__(self) -> None:
        self.settings = dict(GENERATOR)
        self.high, self.low = 0.05, -0.05
        self.uploads: dict[str, np.ndarray] = {}
        self.log: list[str] = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"TCPIP::127.0.0.1::{self._listener.getsockname()[1]}::SOCKET"
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._listener.close()
        self._thread.join(5)

    def _run(self) -> None:
        connection, _ = self._listener.accept()
        with connection, connection.makefile("rb") as stream:
            while (byte := stream.read(1)) != b"":
                message = byte
                while not message.endswith(b"\n"):
                    message += stream.read(1)
                    if message.endswith(b",#"):
                        size = int(stream.read(int(stream.read(1))))
                        name = message.decode().split()[1].split(",")[0]
                        self.uploads[name] = np.frombuffer(stream.read(size), "<i2")
                        message = b"" + stream.read(1)
                for part in message.decode().strip().split(";"):
                    if (answer := self._do(part.strip().lstrip(":"))) is not None:
                        connection.sendall(answer if isinstance(answer, bytes) else answer.encode())

    def _do(self, part: str) -> str | bytes | None:
        if not part:
            return None
        self.log.append(part)
        header, _, value = part.partition(" ")
        if header == "SYST:ERR?":
            return '0,"no error"\n'
        if header == "*IDN?":
            return "Keysight Technologies,33512B,SIMOTHER,1.0\n"
        if header == "*OPC?":
            return "+1\n"
        levels = {"HIGH": self.high, "LOW": self.low, "OFFS": (self.high + self.low) / 2}
        for name, level in levels.items():
            if header == f"SOUR1:VOLT:{name}?":
                return f"{level:.4f}\n"
        if header == "SOUR1:VOLT:HIGH":
            self.high = float(value)
        elif header == "SOUR1:VOLT:LOW":
            self.low = float(value)
        elif header == "SOUR1:VOLT:OFFS":
            half = (self.high - self.low) / 2
            self.high, self.low = float(value) + half, float(value) - half
        elif header.endswith("?"):
            return self.settings[header[:-1]] + "\n"
        elif header == "SOUR1:FUNC:ARB":
            self.settings[header] = f'"INT:\\{value.lower()}.arb"'
        elif header == "OUTP1:LOAD":
            self.settings[header] = "9.9E37"
        else:
            self.settings[header] = LONG.get(value, value)
        return None


@pytest.fixture
def server():
    server = OwnWay()
    yield server
    server.close()


def test_the_generators_driver_understands_another_servers_answers(server, line):
    dac = Keysight33500B(line(server.address))
    assert dac.connect().serial == "SIMOTHER"
    moved = dac.go_to_rest(-10.0, slew_v_per_s=5.0, clock=VirtualClock())
    assert moved["to_v"] == pytest.approx(-10.0)
    codes = np.full(100, -32767, np.int16)
    codes[1:-1] = np.linspace(-32767, 32767, 98).astype(np.int16)
    dac.load("sweep 1", codes, -10.0, -2.5, 5000)
    dac.start()
    dac.wait(0.02)
    dac.close()
    assert any(np.array_equal(upload, codes) for upload in server.uploads.values())
    assert (server.high, server.low) == (pytest.approx(-2.5), pytest.approx(-10.0))
    assert server.log.index("OUTP1:LOAD INF") < server.log.index("OUTP1 ON")
    assert server.log.index("OUTP1 ON") < server.log.index("*TRG")
    assert "*RST" not in server.log


class Silent:
    """A digitizer that has nothing to say when nothing was recorded."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"TCPIP::127.0.0.1::{self._listener.getsockname()[1]}::SOCKET"
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join(5)

    def _run(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            with connection, connection.makefile("rb") as stream:
                for message in stream:
                    if b"IDN" in message:
                        connection.sendall(b"Agilent,L4532A,SIM1,1\n")
                    elif b"SYST:ERR?" in message:
                        connection.sendall(b'+0,"No error"\n')


def test_a_digitizer_that_stays_silent_without_a_record_means_no_trigger(line):
    server = Silent()
    digitizer = KeysightL4532A(line(server.address, timeout_s=0.05))
    digitizer.connect()
    with pytest.raises(InstrumentError) as failure:
        digitizer.fetch([1], 100, timeout_s=0.0)
    assert failure.value.code == "instrument-no-trigger"
    digitizer.close()
    server.close()
