"""A National Instruments card behind a line of bytes: one analog output, one input, one clock.

Never tried on hardware.

Everything that is done with the card goes through `NidaqmxCard`, which takes messages and answers
them, in the process that holds it. That process is the guard: NI-DAQmx ends the tasks of a process
that dies, and a card then holds whatever level it had reached, so tasks must belong to the one that
outlives the runner. `CardTransport` makes it a `Transport` like any other; a simulated bench serves
the same card, with a stand-in for the ``nidaqmx`` package, over a socket.

Messages, in the framing of `drivers.scpi`; AO is the output, AI the input:

    *IDN?  *CLS  SYST:ERR?
    AO:LEV?                  volts on the output, measured; not while a burst plays
    AO:RATE r   AO:DATA n,#block   AO:STAR   AO:DONE?   AO:POIN?
    AI:CHAN c   AI:RANG v   AI:COUN n   AI:TRIG AO|IMM   AI:ARM   AI:ABOR   AI:DONE?
    AI:DATA? offset,count    little-endian doubles in a block

The output is the master: its sample clock is the input's too, so that whatever happens to the
acquisition, a burst plays to its end, which is at rest. There is no message that stops a burst.

Source: NI-DAQmx Help, "Analog Output" and "Internal Channels"; nidaqmx-python 1.x.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.clock import RealClock
from drivers.scpi import (
    ErrorEntry,
    ErrorQueue,
    MessageSplitter,
    ScpiSyntaxError,
    Unit,
    block_argument,
    encode_block,
    parse_message,
)
from drivers.transport import BufferedTransport, Observer

ADDRESS = re.compile(r"(?P<device>[A-Za-z][\w-]*)/ao\d+(?:,(?P<readback>ai\d+))?", re.IGNORECASE)
"""``Dev1/ao0``; with ``,ai7`` the output is read back at that input, to which it is wired."""
LIMIT_V = 10.0
JUMP_V = 0.05
"""What a burst's first sample may be away from the level that is measured: 0.4 V on the stack."""
_LEVEL_READINGS = 100
_CLOSING_S = 600.0


class Refused(Exception):
    """A message that the card does not carry out, with the code for the error queue."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.entry = ErrorEntry(code, text)


class NidaqmxCard:
    """One output and one input of a card.

    Parameters
    ----------
    nidaqmx : the package, or a stand-in for it
    address : as `ADDRESS`
    """

    def __init__(self, nidaqmx: Any, address: str) -> None:
        found = ADDRESS.fullmatch(address)
        if found is None:
            raise ValueError(f"{address!r} is no analog output such as Dev1/ao0")
        self._daq = nidaqmx
        self._device = found["device"]
        self._output = address.partition(",")[0]
        # Cards without the internal channel need a wire from the output to an input.
        self._readback = found["readback"] or f"_{self._output.rpartition('/')[2]}_vs_aognd"
        self._errors = ErrorQueue()
        self._ao: Any = None  # the task of the latest burst
        self._ai: Any = None
        self._samples: NDArray[np.float64] = np.empty(0)
        self._recorded: NDArray[np.float64] | None = None
        self._state: dict[str, Any] = {
            "AO:RATE": 1000.0, "AI:CHAN": "ai0", "AI:RANG": 10.0, "AI:COUN": 2, "AI:TRIG": "AO",
        }

    # ---------------------------------------------------------------- messages

    def execute(self, message: bytes) -> bytes:
        """Carry out one message; its answer, empty where there is none."""
        answers: list[bytes] = []
        try:
            for unit in parse_message(message):
                try:
                    answer = self._carry_out(unit)
                except Refused as error:
                    self._errors.push(error.entry)
                except ScpiSyntaxError:
                    raise
                except (ValueError, TypeError) as error:
                    self._errors.push(ErrorEntry(-222, f"Data out of range; {error}"))
                except self._daq.errors.Error as error:
                    first = str(error).strip().partition("\n")[0]
                    self._errors.push(ErrorEntry(int(getattr(error, "error_code", -310)), first))
                else:
                    if unit.query:
                        answers.append(answer)
        except ScpiSyntaxError as error:
            self._errors.push(ErrorEntry(error.code, error.text))
        return b";".join(answers) + b"\n" if answers else b""

    def _carry_out(self, unit: Unit) -> bytes:
        actions: dict[tuple[str, bool], Callable[[Unit], Any]] = {
            ("*IDN", True): lambda _: self._identification(),
            ("*CLS", False): lambda _: self._errors.clear(),
            ("SYST:ERR", True): lambda _: str(self._errors.pop()),
            ("AO:LEV", True): lambda _: f"{self._level():.6f}",
            ("AO:DATA", False): self._take_samples,
            ("AO:POIN", True): lambda _: str(self._samples.size),
            ("AO:STAR", False): lambda _: self._start(),
            ("AO:DONE", True): lambda _: str(int(not self._plays())),
            ("AI:ARM", False): lambda _: self._arm(),
            ("AI:ABOR", False): lambda _: self._drop_input(),
            ("AI:DONE", True): lambda _: str(int(self._has_recorded())),
            ("AI:DATA", True): self._fetch,
        }
        action = actions.get((unit.header, unit.query))
        if action is None and unit.header in self._state:
            action = self._tell if unit.query else self._set
        if action is None:
            raise ScpiSyntaxError(-113, f"Undefined header {unit.header[:40]}")
        answer = action(unit)
        return answer if isinstance(answer, bytes) else str(answer or "").encode("latin-1")

    def _identification(self) -> str:
        system = self._daq.system.System.local()
        device = system.devices[self._device]
        serial = f"{int(device.serial_num):08X}"
        if device.is_simulated:
            serial = f"SIM{serial}"
        version = system.driver_version
        return (f"National Instruments,{device.product_type},{serial},"
                f"{version.major_version}.{version.minor_version}")

    def _set(self, unit: Unit) -> None:
        before = self._state[unit.header]
        text = unit.text(0)
        value: Any = text if isinstance(before, str) else type(before)(float(text))
        if not isinstance(value, str) and not 0 < value < 1e9:
            raise ValueError(f"{unit.header} {text}")
        if unit.header == "AI:TRIG" and value not in ("AO", "IMM"):
            raise ValueError(f"AI:TRIG {text}")
        self._state[unit.header] = value

    def _tell(self, unit: Unit) -> str:
        value = self._state[unit.header]
        return value if isinstance(value, str) else f"{value:.12g}"

    # ------------------------------------------------------------------ output

    def _plays(self) -> bool:
        """Whether a burst is under way; a finished one's task is let go, and the card holds."""
        if self._ao is not None and self._ao.is_task_done():
            task, self._ao = self._ao, None
            task.close()
        return self._ao is not None

    def _level(self) -> float:
        """Volts on the output, the mean of some readings of what it is wired to."""
        if self._plays():
            raise Refused(-213, "a burst is playing; its level cannot be measured")
        self._keep_record()
        with self._daq.Task() as task:
            task.ai_channels.add_ai_voltage_chan(
                f"{self._device}/{self._readback}", min_val=-LIMIT_V, max_val=LIMIT_V
            )
            readings = task.read(number_of_samples_per_channel=_LEVEL_READINGS)
        return float(np.mean(readings))

    def _take_samples(self, unit: Unit) -> None:
        samples = np.frombuffer(block_argument(unit.arguments[1]), "<f8").copy()
        if samples.size != int(unit.text(0)) or samples.size < 2:
            raise ValueError(f"{samples.size} samples")
        if not (np.abs(samples) <= LIMIT_V).all():  # false for what is no number, too
            raise ValueError(f"a sample beyond +-{LIMIT_V:g} V")
        if self._plays():
            raise Refused(-213, "a burst is playing")
        self._samples = samples

    def _start(self) -> None:
        if self._plays():
            raise Refused(-213, "a burst is playing")
        if self._samples.size < 2:
            raise Refused(-221, "Settings conflict; no samples were loaded")
        if self._ai is None:  # with an acquisition armed, the inputs are taken
            level = self._level()
            if abs(level - float(self._samples[0])) > JUMP_V:
                raise Refused(-221, f"Settings conflict; the output is at {level:.3f} V, the "
                                    f"burst begins at {self._samples[0]:.3f} V")
        constants = self._daq.constants
        task = self._daq.Task()
        try:
            task.ao_channels.add_ao_voltage_chan(self._output, min_val=-LIMIT_V, max_val=LIMIT_V)
            task.timing.cfg_samp_clk_timing(
                self._state["AO:RATE"], sample_mode=constants.AcquisitionType.FINITE,
                samps_per_chan=self._samples.size,
            )
            task.write(self._samples, auto_start=False)
            task.start()
        except BaseException:
            task.close()
            raise
        self._ao = task

    # ------------------------------------------------------------------- input

    def _arm(self) -> None:
        self._drop_input()
        constants, state = self._daq.constants, self._state
        task = self._daq.Task()
        try:
            task.ai_channels.add_ai_voltage_chan(
                f"{self._device}/{state['AI:CHAN']}", min_val=-state["AI:RANG"],
                max_val=state["AI:RANG"],
            )
            source = f"/{self._device}/ao/SampleClock" if state["AI:TRIG"] == "AO" else ""
            task.timing.cfg_samp_clk_timing(
                state["AO:RATE"], source=source, sample_mode=constants.AcquisitionType.FINITE,
                samps_per_chan=state["AI:COUN"],
            )
            task.start()
        except BaseException:
            task.close()
            raise
        self._ai = task

    def _has_recorded(self) -> bool:
        return self._recorded is not None or (self._ai is not None and self._ai.is_task_done())

    def _keep_record(self) -> None:
        """Read what was recorded and let go of the input; what was armed in vain is dropped."""
        if self._ai is None:
            return
        task, self._ai = self._ai, None
        try:
            if task.is_task_done():
                self._recorded = np.asarray(
                    task.read(number_of_samples_per_channel=self._state["AI:COUN"]), float
                )
        finally:
            task.close()

    def _drop_input(self) -> None:
        self._recorded = None
        if self._ai is not None:
            task, self._ai = self._ai, None
            task.close()

    def _fetch(self, unit: Unit) -> bytes:
        if self._recorded is None and self._has_recorded():
            self._keep_record()
        if self._recorded is None:
            raise Refused(-230, "Data corrupt or stale; nothing was recorded")
        offset, count = int(unit.text(0)), int(unit.text(1))
        return encode_block(self._recorded[offset : offset + count].astype("<f8").tobytes())

    def close(self) -> None:
        """Let go of the card; a burst that plays is waited for, because a stop would freeze it."""
        clock = RealClock()
        while self._plays() and clock.now() < _CLOSING_S:
            clock.sleep(0.01)
        self._drop_input()


class CardTransport(BufferedTransport):
    """A card of this computer as a `Transport`; the card is this process's as long as it is open.

    InstrumentError instrument-refused where the ``nidaqmx`` package or NI's driver is missing.
    """

    def __init__(
        self, address: str, instrument: str, timeout_s: float, observer: Observer | None = None
    ) -> None:
        self._card: NidaqmxCard | None = None
        self._splitter = MessageSplitter()
        self._answers = bytearray()
        super().__init__(address, instrument, timeout_s, observer)

    def _open(self) -> None:
        if self._card is not None:
            return
        try:
            import nidaqmx
            import nidaqmx.system
        except ImportError:
            raise self._error(
                "instrument-refused", "the Python package nidaqmx is not installed",
                "it is an extra of this program", "pip install 'piezo-rig[nidaqmx]'",
            ) from None
        card = NidaqmxCard(nidaqmx, self.address)
        try:
            card._identification()
        except Exception as error:  # of the package, or of a driver that is not there
            first = str(error).strip().partition("\n")[0]
            raise self._error(
                "instrument-refused", f"NI-DAQmx does not know the card: {first}",
                "NI-DAQmx is not installed, or the card has another name or is unplugged",
                "look the name up in NI MAX (or with nilsdev), and correct the address",
            ) from None
        self._card = card

    def reopen(self) -> None:
        """Forget what was on its way; the card and a burst that plays stay as they are."""
        self._buffer.clear()
        self._answers.clear()
        self._splitter = MessageSplitter()
        self._open()
        self._is_open = True
        self._observe("event", b"reopened")

    def _shut(self) -> None:
        card, self._card = self._card, None
        if card is not None:
            card.close()

    def _send(self, data: bytes, deadline: float) -> None:
        assert self._card is not None
        for message in self._splitter.feed(data):
            self._answers += self._card.execute(message)

    def _receive(self, wanted: int, deadline: float) -> bytes:
        if not self._answers:
            raise self._timed_out()  # everything is answered at once, or never
        return self._waiting()

    def _waiting(self) -> bytes:
        data = bytes(self._answers)
        self._answers.clear()
        return data


def is_card(address: str) -> bool:
    """Whether an address of the rig's config names a card of this computer."""
    return ADDRESS.fullmatch(address) is not None

