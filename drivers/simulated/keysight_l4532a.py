"""A simulated Keysight L4532A: two simultaneous channels, 16 bit, one record per trigger.

Behaviour after the user's guide (L4532-90001) as far as the driver and any plain
SCPI client need it. The bits of ``STAT:OPER:COND?`` are a guess. A record is
read when its end has passed: on a virtual clock a fetch jumps there, on a real
one it waits.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, MutableMapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.clock import Clock
from drivers.scpi import Unit, encode_block
from drivers.scpi_values import (
    NO_DATA,
    format_number,
    parse_channel_list,
    parse_number,
    parse_word,
)
from drivers.simulated.scpi_device import ScpiDevice, ScpiError, pass_until
from drivers.simulated.wiring import Capture, Wiring

RATES = tuple(m * 10.0**n for n in range(3, 8) for m in (1, 2, 5) if m * 10**n <= 20_000_000)
RANGES_V = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0)
MEMORY_SAMPLES = 32 * 1024 * 1024
CODE_FULL_SCALE = 32767
CODE_NO_DATA = -32768
_MEASURING, _WAITING = 16, 32
_POLL_S = 0.005
_COUPLINGS = ("DC", "AC")
_FILTERS = ("LP_20_MHZ", "LP_2_MHZ", "LP_200_KHZ")
INPUTS = {1: "stack_v", 2: "sensor_v"}


class SimulatedKeysightL4532A(ScpiDevice):
    """An L4532A as it stands after power-on.

    ``inputs`` says which of the plant's voltages is connected to which channel.
    """

    def __init__(
        self,
        wiring: Wiring,
        clock: Clock,
        serial: str = "SIM00002",
        faults: MutableMapping[str, Any] | None = None,
        inputs: Mapping[int, str] = INPUTS,
    ) -> None:
        super().__init__(clock, f"Agilent Technologies,L4532A,{serial},2.01-1.02", faults)
        self._wiring = wiring
        self._inputs = dict(inputs)
        self._channels: dict[int, dict[str, Any]] = {
            n: {"range": 256.0, "coupling": "DC", "filter": "LP_20_MHZ"} for n in self._inputs
        }
        self._armed = False
        self._capture: Capture | None = None
        self._codes: dict[int, NDArray[np.int16]] = {}
        self._declare()
        wiring.connect_trigger(self._external_pulse)

    def _declare(self) -> None:
        acquire = "CONFigure:ACQuire"
        self.state.update(rate=1e6, count=1024.0)
        self._defaults.update(rate=1e6, count=1024.0)
        self.on(f"{acquire}:SRATe", set=self._set_rate, get=self._tell_rate)
        self.on(f"{acquire}:SCOunt", set=self._set_count, get=self._tell_count)
        self.on(f"{acquire}:SCOunt:MAXimum", get=lambda unit: f"+{MEMORY_SAMPLES}")
        self.number("pretrigger", f"{acquire}:SPRetrigger", 0.0, 0.0, MEMORY_SAMPLES)
        self.number("records", f"{acquire}:RECords", 1.0, 1.0, 1024.0)
        channel = "CONFigure:CHANnel"
        self.on(f"{channel}:RANGe", set=self._set_range, most=2, get=self._tell_channel("range"))
        self.on(
            f"{channel}:COUPling",
            set=self._set_word("coupling", _COUPLINGS),
            get=self._tell_channel("coupling"),
            most=2,
        )
        self.on(
            f"{channel}:FILTer",
            set=self._set_word("filter", _FILTERS),
            get=self._tell_channel("filter"),
            most=2,
        )
        arms = ("IMMediate", "SOFTware", "TIMer", "EXTernal")
        self.choice("arm", "CONFigure:ARM:SOURce", arms, "IMM")
        triggers = ("IMMediate", "SOFTware", "EXTernal", "CHANnel", "OR")
        self.choice("trigger", "CONFigure:TRIGger:SOURce", triggers, "IMM")
        edges = ("POSitive", "NEGative")
        self.choice("edge", "CONFigure:EXTernal:INPut", edges, "POS")
        self.choice("border", "FORMat:BORDer", ("NORMal", "SWAPped"), "NORM")
        self.state["real"] = self._defaults["real"] = 32
        self.on("FORMat:DATA:REAL", set=self._set_real, most=2, get=self._tell_real)
        self.on("INITiate[:IMMediate]", set=self._initiate)
        self.on("ABORt", set=lambda unit: self._abort())
        self.on("TRIGger[:IMMediate]", set=self._software_trigger)
        self.on("*TRG", set=self._software_trigger)
        self.on("STATus:OPERation:CONDition", get=lambda unit: f"+{self._condition()}")
        self.on("FETCh:WAVeform:VOLTage", get=self._fetch_volts, most=4)
        self.on("FETCh:WAVeform:ADC", get=self._fetch_codes, most=4)

    def reset(self) -> None:
        super().reset()
        for settings in self._channels.values():
            settings.update(range=256.0, coupling="DC", filter="LP_20_MHZ")
        self._abort()
        self._capture = None

    # ----------------------------------------------------------------- settings

    def _set_rate(self, unit: Unit) -> None:
        words = {"MINimum": RATES[0], "MAXimum": RATES[-1], "DEFault": 1e6}
        asked = parse_number(unit.text(0), words)
        if not RATES[0] <= asked <= RATES[-1]:
            raise ScpiError(-222, "Data out of range; sample rate")
        nearest = min(RATES, key=lambda rate: abs(rate - asked))
        if abs(nearest - asked) > 1e-6 * nearest:
            raise ScpiError(-224, "Illegal parameter value; sample rate is not on the grid")
        self._abort()
        self.state["rate"] = nearest

    def _tell_rate(self, unit: Unit) -> str:
        words = {"MINimum": RATES[0], "MAXimum": RATES[-1], "DEFault": 1e6}
        return format_number(
            parse_number(unit.text(0), words) if unit.arguments else self.state["rate"]
        )

    def _set_count(self, unit: Unit) -> None:
        words = {"MINimum": 8.0, "MAXimum": float(MEMORY_SAMPLES), "DEFault": 1024.0}
        asked = parse_number(unit.text(0), words)
        if not 8 <= asked <= MEMORY_SAMPLES:
            raise ScpiError(-222, "Data out of range; sample count")
        if asked % 4:
            raise ScpiError(-224, "Illegal parameter value; sample count is no multiple of 4")
        self._abort()
        self.state["count"] = asked

    def _tell_count(self, unit: Unit) -> str:
        words = {"MINimum": 8.0, "MAXimum": float(MEMORY_SAMPLES), "DEFault": 1024.0}
        count = parse_number(unit.text(0), words) if unit.arguments else self.state["count"]
        return f"+{count:.0f}"

    def _named_channels(self, unit: Unit, index: int = 0) -> list[int]:
        channels = parse_channel_list(unit.text(index))
        if any(channel not in self._channels for channel in channels):
            raise ScpiError(-222, "Data out of range; no such channel")
        return channels

    def _set_range(self, unit: Unit) -> None:
        words = {"MINimum": RANGES_V[0], "MAXimum": RANGES_V[-1], "DEFault": 256.0}
        channels, asked = self._named_channels(unit), parse_number(unit.text(1), words)
        if asked not in RANGES_V:
            raise ScpiError(-224, "Illegal parameter value; range")
        for channel in channels:
            self._channels[channel]["range"] = asked

    def _set_word(self, key: str, choices: tuple[str, ...]):  # type: ignore[no-untyped-def]
        def change(unit: Unit) -> None:
            channels, word = self._named_channels(unit), parse_word(unit.text(1), choices)
            for channel in channels:
                self._channels[channel][key] = word

        return change

    def _tell_channel(self, key: str):  # type: ignore[no-untyped-def]
        def tell(unit: Unit) -> str:
            values = [self._channels[channel][key] for channel in self._named_channels(unit)]
            return ",".join(
                value if isinstance(value, str) else format_number(float(value)) for value in values
            )

        return tell

    def _set_real(self, unit: Unit) -> None:
        bits = unit.text(len(unit.arguments) - 1)
        if bits.upper() == "REAL":
            bits = "32"
        if parse_number(bits) not in (32, 64):
            raise ScpiError(-224, "Illegal parameter value")
        self.state["real"] = int(parse_number(bits))

    def _tell_real(self, unit: Unit) -> str:
        return f"REAL,{self.state['real']}"

    # ---------------------------------------------------------------- triggering

    def _initiate(self, unit: Unit) -> None:
        self._wiring.now()
        if self._armed or self._running():
            raise ScpiError(-213, "Init ignored")
        self._drop()
        self._armed = True
        if self.state["trigger"] == "IMM":
            self._begin(self._wiring.now())

    def _abort(self) -> None:
        self._armed = False
        if self._capture is not None and self._running():
            self._drop()

    def _drop(self) -> None:
        if self._capture is not None:
            self._wiring.drop(self._capture)
        self._capture = None
        self._codes = {}

    def _running(self) -> bool:
        self._wiring.finish_captures()
        return self._capture is not None and self._capture.record is None

    def _begin(self, t: float) -> None:
        self._armed = False
        self._codes = {}
        self._capture = self._wiring.capture(t, self.state["rate"], int(self.state["count"]))

    def _external_pulse(self, t: float, rising: bool) -> None:
        right_edge = rising == (self.state["edge"] == "POS")
        waits = self._armed and self.state["trigger"] == "EXT" and right_edge
        if waits and not self.faults.strike("no_trigger"):
            self._begin(t)

    def _software_trigger(self, unit: Unit) -> None:
        if not self._armed or self.state["trigger"] != "SOFT":
            raise ScpiError(-211, "Trigger ignored")
        self._begin(self._wiring.now())

    def _condition(self) -> int:
        return (_WAITING if self._armed else 0) | (_MEASURING if self._running() else 0)

    async def complete(self) -> None:
        while self._armed:  # until something triggers or aborts
            await asyncio.sleep(_POLL_S)
        await self._finish()

    async def _finish(self) -> None:
        if self._capture is not None and self._running():
            await pass_until(self.clock, self._capture.end)
            self._wiring.finish_captures()

    # ------------------------------------------------------------------- fetching

    async def _samples(self, unit: Unit) -> tuple[list[int], NDArray[np.int32]]:
        """Channels and codes (count, channels); no data where nothing was recorded."""
        channels = self._named_channels(unit)
        offset = int(parse_number(unit.text(1))) if len(unit.arguments) > 1 else 0
        most = int(self.state["count"]) - offset
        count = int(parse_number(unit.text(2))) if len(unit.arguments) > 2 else most
        if len(unit.arguments) > 3 and parse_channel_list(unit.text(3)) != [1]:
            raise ScpiError(-222, "Data out of range; no such record")
        if offset < 0 or count < 1 or count > MEMORY_SAMPLES:
            raise ScpiError(-222, "Data out of range")
        await self._finish()
        if self._capture is not None and not self._codes:
            self._digitize(self._capture)
        out = np.full((count, len(channels)), CODE_NO_DATA, np.int32)
        for column, channel in enumerate(channels):
            codes = self._codes.get(channel, np.empty(0, np.int16))[offset : offset + count]
            out[: codes.size, column] = codes
        if fault := self.faults.strike("no_data"):
            out[max(0, int(fault.value) - offset) :] = CODE_NO_DATA
        return channels, out

    def _digitize(self, capture: Capture) -> None:
        for channel, name in self._inputs.items():
            volts = np.asarray(getattr(capture.record, name), dtype=float)
            if self._channels[channel]["coupling"] == "AC":
                volts = volts - volts.mean()
            scaled = np.rint(volts / float(self._channels[channel]["range"]) * CODE_FULL_SCALE)
            clipped = np.clip(np.nan_to_num(scaled), -CODE_FULL_SCALE, CODE_FULL_SCALE)
            self._codes[channel] = clipped.astype(np.int16)

    def _order(self) -> str:
        swapped = self.state["border"] == "SWAP"
        if self.faults.strike("byte_order"):
            swapped = not swapped
        return "<" if swapped else ">"

    async def _fetch_volts(self, unit: Unit) -> bytes:
        channels, codes = await self._samples(unit)
        per_code = np.array([float(self._channels[c]["range"]) for c in channels])
        volts = codes * (per_code / CODE_FULL_SCALE)
        if not self.faults.strike("no_data_as_codes"):
            volts[codes == CODE_NO_DATA] = NO_DATA
        kind = f"{self._order()}f{self.state['real'] // 8}"
        return encode_block(volts.astype(kind).tobytes(), digits=9)

    async def _fetch_codes(self, unit: Unit) -> bytes:
        _, codes = await self._samples(unit)
        return encode_block(codes.astype(f"{self._order()}i2").tobytes(), digits=9)
