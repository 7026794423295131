"""A bench with a stand-in plant, and a client that shares no code with the drivers."""

from __future__ import annotations

import socket
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.simulated.bench import SimulatedBench


class RememberingPlant:
    """Keeps what it was told; the stack is 7.5 x command + offset, the sensor -0.1 of that."""

    def __init__(self) -> None:
        self.events: list[tuple[float, np.ndarray, float]] = []
        self.offset = 0.0
        self.latest = 0.0

    def _in_order(self, t: float) -> None:
        assert t >= self.latest - 1e-12, f"{t} comes before {self.latest}"
        self.latest = max(self.latest, t)

    def set_level(self, t: float, command_v: float) -> None:
        self._in_order(t)
        self.events.append((t, np.array([command_v]), 1.0))

    def play(
        self, t: float, command_v: np.ndarray, rate: float, holds_last: bool = False
    ) -> None:
        if holds_last:
            command_v = np.append(command_v, command_v[-1])
        self._in_order(t)
        self.events.append((t, np.asarray(command_v), rate))

    def set_amplifier_offset(self, t: float, volts: float) -> None:
        self._in_order(t)
        self.offset = volts

    def command(self, times: np.ndarray) -> np.ndarray:
        out = np.zeros(len(times))
        owner = np.searchsorted([t for t, _, _ in self.events], times + 1e-9, side="right") - 1
        for index in np.unique(owner[owner >= 0]):
            t, values, rate = self.events[index]
            mine = owner == index
            k = np.floor((times[mine] - t) * rate + 1e-6).astype(int)
            out[mine] = values[np.where(k < len(values), k, 0)]
        return out

    def stack_v(self, t: float) -> float:
        return float(self.offset + 7.5 * self.command(np.array([t]))[0])

    def record(self, t: float, rate: float, count: int) -> SimpleNamespace:
        stack = self.offset + 7.5 * self.command(t + np.arange(count) / rate)
        self._in_order(t + (count - 1) / rate)
        return SimpleNamespace(stack_v=stack, sensor_v=-0.1 * stack)

    @property
    def levels(self) -> list[float]:
        """The command levels in order, bursts left out."""
        return [float(values[0]) for _, values, _ in self.events if values.size == 1]


class PlainClient:
    """A socket and nothing else."""

    def __init__(self, address: str) -> None:
        _, host, port, _ = address.split("::")
        self.socket = socket.create_connection((host, int(port)), timeout=10)
        self._kept = b""

    def send(self, data: bytes) -> None:
        self.socket.sendall(data)

    def line(self) -> str:
        while b"\n" not in self._kept:
            data = self.socket.recv(65536)
            if not data:
                raise EOFError
            self._kept += data
        line, _, self._kept = self._kept.partition(b"\n")
        return line.decode()

    def exactly(self, count: int) -> bytes:
        while len(self._kept) < count:
            self._kept += self.socket.recv(65536)
        data, self._kept = self._kept[:count], self._kept[count:]
        return data

    def ask(self, message: str) -> str:
        self.send(message.encode() + b"\n")
        return self.line()

    def ask_block(self, message: str) -> bytes:
        self.send(message.encode() + b"\n")
        head = self.exactly(2)
        assert head[:1] == b"#"
        payload = self.exactly(int(self.exactly(int(head[1:]))))
        assert self.exactly(1) == b"\n"
        return payload


@pytest.fixture
def clock():
    return VirtualClock()


@pytest.fixture
def plant():
    return RememberingPlant()


@pytest.fixture
def faults():
    return {"waveform_dac": {}, "digitizer": {}, "amplifier": {}}


@pytest.fixture
def bench(plant, clock, faults):
    with SimulatedBench(plant, clock, faults=faults) as bench:
        yield bench


@pytest.fixture
def plain():
    """``plain(address)`` is a plain socket to that address."""
    opened = []

    def connect(address: str) -> PlainClient:
        opened.append(PlainClient(address))
        return opened[-1]

    yield connect
    for client in opened:
        client.socket.close()


@pytest.fixture
def client(bench, plain):
    """``client('waveform_dac')`` is a plain socket to that simulated instrument."""
    return lambda name: plain(bench.addresses[name])


@pytest.fixture
def line():
    """``line(address)`` opens a transport that is closed after the test."""
    from drivers.transport import open_transport

    opened = []

    def connect(address: str, timeout_s: float = 2.0, observer=None):
        opened.append(open_transport(address, "instrument", timeout_s, observer))
        return opened[-1]

    yield connect
    for transport in opened:
        transport.close()
