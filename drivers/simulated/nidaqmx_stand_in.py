"""A stand-in for the ``nidaqmx`` package, with one card whose wires lead to the simulated plant.

It has the part of the package's interface that `drivers.nidaqmx_card` uses, with the same names
and arguments, and does what the card would: a finite generation is played once and its last sample
held; an acquisition that is clocked by the output begins with it; a subsystem that is in use is
refused to others; an output that was never written to is at 0 V.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, MutableMapping
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.clock import Clock
from drivers.nidaqmx_card import NidaqmxCard
from drivers.scpi import MessageSplitter
from drivers.simulated.faults import Faults
from drivers.simulated.wiring import Capture, Wiring

ADDRESS = "Dev1/ao0"
SENSOR = "Dev1/ai0"
_RESERVED, _BAD_DEVICE, _BAD_TIMING = -50103, -200220, -200077
_LSB_V = 20.0 / 65_536


class Error(Exception):
    """As the package's base class of errors."""


class DaqError(Error):
    """As the package's error of its driver."""

    def __init__(self, message: str, error_code: int, task_name: str = "") -> None:
        super().__init__(message)
        self.error_code = error_code


class SimulatedCard:
    """The hardware: what the output puts out, what the input records."""

    def __init__(self, wiring: Wiring, serial: int) -> None:
        self.wiring = wiring
        self.serial = serial
        self.busy: dict[str, Task] = {}  # subsystem -> the task that has reserved it
        self._samples = np.zeros(1)  # of the generation, the last of which is held
        self._begin, self._rate = 0.0, 1.0

    @property
    def end_s(self) -> float:
        return self._begin + (self._samples.size - 1) / self._rate

    def level(self) -> float:
        """Volts on the output now."""
        k = int((self.wiring.now() - self._begin) * self._rate + 1e-6)
        return float(self._samples[min(max(k, 0), self._samples.size - 1)])

    def generate(self, samples: NDArray[np.float64], rate: float) -> None:
        self._begin, self._rate = self.wiring.now(), rate
        self._samples = np.round(samples / _LSB_V) * _LSB_V
        waiting = self.busy.get("ai")
        self.wiring.play(self._begin, self._samples, rate, holds_last=True)
        if waiting is not None:
            waiting.clocked(self._begin)

    def freeze(self) -> None:
        """A generation that is stopped stays where it is."""
        now = self.wiring.now()
        if now < self.end_s:
            level = self.level()
            self._samples, self._begin = np.array([level]), now
            self.wiring.set_level(now, level)


class Task:
    """As the package's class of that name."""

    def __init__(self, new_task_name: str = "", *, _card: SimulatedCard) -> None:
        self._card = _card
        self._kind = self._channel = self._source = ""
        self._range_v = 10.0
        self._rate, self._count = 0.0, 0
        self._data: NDArray[np.float64] = np.empty(0)
        self._capture: Capture | None = None
        self.ao_channels = SimpleNamespace(add_ao_voltage_chan=self._add_output)
        self.ai_channels = SimpleNamespace(add_ai_voltage_chan=self._add_input)
        self.timing = SimpleNamespace(cfg_samp_clk_timing=self._clock)

    def __enter__(self) -> Task:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _add_output(
        self, physical_channel: str, name_to_assign_to_channel: str = "", min_val: float = -10.0,
        max_val: float = 10.0,
    ) -> None:
        self._add("ao", physical_channel, max_val)

    def _add_input(
        self, physical_channel: str, name_to_assign_to_channel: str = "",
        terminal_config: Any = None, min_val: float = -5.0, max_val: float = 5.0,
    ) -> None:
        self._add("ai", physical_channel, max_val)

    def _add(self, kind: str, channel: str, range_v: float) -> None:
        device, _, self._channel = channel.partition("/")
        if device != ADDRESS.partition("/")[0]:
            raise DaqError(f"Device identifier is invalid.\nDevice Specified: {device}",
                           _BAD_DEVICE)
        self._kind, self._range_v = kind, range_v

    def _clock(
        self, rate: float, source: str = "", active_edge: Any = None, sample_mode: Any = None,
        samps_per_chan: int = 1000,
    ) -> None:
        if source not in ("", "/Dev1/ao/SampleClock"):
            raise DaqError(f"No route to {source}", _BAD_TIMING)
        self._rate, self._source, self._count = rate, source, samps_per_chan

    def write(self, data: Any, auto_start: Any = None, timeout: float = 10.0) -> int:
        self._data = np.array(data, dtype=float)
        if np.abs(self._data).max() > self._range_v or self._data.size != self._count:
            raise DaqError("Requested value is not supported for this property.", _BAD_TIMING)
        return int(self._data.size)

    def start(self) -> None:
        other = self._card.busy.get(self._kind)
        if other is not None:
            raise DaqError("The specified resource is reserved.\nThe operation could not be "
                           "completed as specified.", _RESERVED)
        self._card.busy[self._kind] = self
        if self._kind == "ao":
            self._card.generate(self._data, self._rate)
        elif not self._source:
            self.clocked(self._card.wiring.now())

    def clocked(self, begin: float) -> None:
        """The clock of an acquisition runs from now on."""
        if self._kind == "ai" and self._capture is None:
            self._capture = self._card.wiring.capture(begin, self._rate, self._count)

    def is_task_done(self) -> bool:
        if self._kind == "ao":
            return self._card.wiring.now() >= self._card.end_s
        self._card.wiring.finish_captures()
        return self._capture is not None and self._capture.record is not None

    def read(
        self, number_of_samples_per_channel: int = 1, timeout: float = 10.0
    ) -> list[float]:
        if not self._rate:  # on demand
            if self._card.busy.get("ai") is not None:
                raise DaqError("The specified resource is reserved.", _RESERVED)
            level = self._card.level() if self._channel == "_ao0_vs_aognd" else 0.0
            return [round(level / _LSB_V) * _LSB_V] * number_of_samples_per_channel
        if not self.is_task_done() or self._capture is None or self._capture.record is None:
            raise DaqError("Some or all of the samples requested have not yet been acquired.",
                           -200284)
        volts = np.zeros(self._count)
        if self._channel == SENSOR.partition("/")[2]:
            volts = np.asarray(self._capture.record.sensor_v, float)
        step_v = self._range_v / 32_768
        codes = np.clip(np.rint(volts / step_v), -32_768, 32_767)
        return [float(v) for v in codes[:number_of_samples_per_channel] * step_v]

    def stop(self) -> None:
        if self._card.busy.get(self._kind) is self:
            if self._kind == "ao":
                self._card.freeze()
            del self._card.busy[self._kind]
        if self._capture is not None and self._capture.record is None:
            self._card.wiring.drop(self._capture)

    def close(self) -> None:
        self.stop()


def stand_in(wiring: Wiring, serial: int = 1) -> Any:
    """What stands for the module ``nidaqmx``."""
    card = SimulatedCard(wiring, serial)
    device = SimpleNamespace(product_type="USB-6363", serial_num=serial, is_simulated=True)
    system = SimpleNamespace(
        devices={"Dev1": device},
        driver_version=SimpleNamespace(major_version=24, minor_version=0),
    )
    return SimpleNamespace(
        Task=lambda new_task_name="": Task(new_task_name, _card=card),
        constants=SimpleNamespace(AcquisitionType=SimpleNamespace(FINITE="FINITE")),
        errors=SimpleNamespace(Error=Error, DaqError=DaqError),
        system=SimpleNamespace(System=SimpleNamespace(local=lambda: system)),
        card=card,
    )


class ServedCard:
    """The card as a device of a simulated bench: the messages of `NidaqmxCard` over a socket."""

    def __init__(
        self, wiring: Wiring, clock: Clock, serial: str = "SIM00001",
        faults: MutableMapping[str, Any] | None = None,
    ) -> None:
        self.faults = Faults(faults, clock)
        self._card = NidaqmxCard(stand_in(wiring, int(serial.removeprefix("SIM"), 16)), ADDRESS)

    def conversation(self) -> ServedConversation:
        return ServedConversation(self._card)


class ServedConversation:
    """Bytes in, messages carried out with their answers out."""

    def __init__(self, card: NidaqmxCard) -> None:
        self._card = card
        self._splitter = MessageSplitter()

    async def feed(self, data: bytes) -> AsyncIterator[tuple[bytes, bytes]]:
        for message in self._splitter.feed(data):
            yield message, self._card.execute(message)
