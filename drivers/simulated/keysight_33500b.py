"""A simulated Keysight 33500B: levels that limit each other, bursts, volatile memory.

Behaviour after the instrument's guide (33500-90901) as far as the drivers and
any plain SCPI client need it. Simplified: changing the output during a burst
ends the burst; a free-running waveform is handed to the plant for a limited
time, after which it rests at its first point.
"""

from __future__ import annotations

import re
from collections.abc import MutableMapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.clock import Clock
from drivers.scpi import ErrorEntry, ScpiSyntaxError, Unit, block_argument
from drivers.scpi_values import INFINITE, arb_name, format_number, parse_number, unquote
from drivers.simulated.scpi_device import ScpiDevice, ScpiError, pass_until
from drivers.simulated.wiring import Wiring

_MEMORY_POINTS = 1_000_000
_ASCII_POINTS = 65_536
_FULL_SCALE = 32767
_SOURCE_OHM = 50.0
_OPEN_LIMIT_V = 10.0
_OPEN_SMALLEST_VPP = 0.002
_FREE_RUN_POINTS = 1_000_000
_FREE_RUN_S = 30.0
_PERIODIC = ("SINusoid", "SQUare", "TRIangle", "RAMP", "PULSe", "PRBS", "NOISe", "ARBitrary")
_BUILT_IN = "EXP_RISE"
_ON_TERMINALS = ("output", "function", "burst", "trigger", "sample_rate", "frequency", "polarity")


class SimulatedKeysight33500B(ScpiDevice):
    """One channel of a 33500B as it stands after power-on: output off, sine, 50 ohm."""

    def __init__(
        self,
        wiring: Wiring,
        clock: Clock,
        serial: str = "SIM00001",
        faults: MutableMapping[str, Any] | None = None,
    ) -> None:
        super().__init__(
            clock, f"Keysight Technologies,33521B,{serial},2.09-1.19-2.00-52-00", faults
        )
        self._wiring = wiring
        self._load = 50.0
        self._vpp, self._offset = 0.1, 0.0  # as displayed, for the load setting
        self._arbs: dict[str, NDArray[np.int16]] = {}
        self._selected = _BUILT_IN
        self._burst_end = float("-inf")
        self._level: float | None = None
        self._declare()
        self._put_out()

    def _declare(self) -> None:
        source = "[SOURce[1]:]"
        self.switch("output", "OUTPut[1][:STATe]", False)
        self.on("OUTPut[1]:LOAD", set=self._set_load, get=self._tell_load)
        self.choice("polarity", "OUTPut[1]:POLarity", ("NORMal", "INVerted"), "NORM")
        self.switch("sync", "OUTPut[1]:SYNC[:STATe]", True)
        self.switch("trigger_out", "OUTPut[1]:TRIGger[:STATe]", False)
        slopes = ("POSitive", "NEGative")
        self.choice("trigger_out_slope", "OUTPut[1]:TRIGger:SLOPe", slopes, "POS")
        self.choice("border", "FORMat:BORDer", ("NORMal", "SWAPped"), "NORM")
        self.choice("function", f"{source}FUNCtion[:SHAPe]", (*_PERIODIC, "DC"), "SIN")
        self.number("frequency", f"{source}FREQuency[:CW]", 1e3, 1e-6, 30e6)
        self.on(f"{source}FUNCtion[:SHAPe]:ARBitrary", set=self._select, get=self._tell_selected)
        rate = f"{source}FUNCtion[:SHAPe]:ARBitrary:SRATe"
        self.number("sample_rate", rate, 40e3, 1e-6, 250e6)
        filters = ("NORMal", "STEP", "OFF")
        self.choice("filter", f"{source}FUNCtion[:SHAPe]:ARBitrary:FILTer", filters, "STEP")
        level = f"{source}VOLTage[:LEVel][:IMMediate]"
        self.on(f"{level}[:AMPLitude]", set=self._set_amplitude, get=self._tell("vpp"))
        self.on(f"{level}:OFFSet", set=self._set_offset, get=self._tell("offset"))
        self.on(f"{level}:HIGH", set=self._set_high, get=self._tell("high"))
        self.on(f"{level}:LOW", set=self._set_low, get=self._tell("low"))
        self.choice("unit", f"{source}VOLTage:UNIT", ("VPP", "VRMS", "DBM"), "VPP")
        self.switch("autorange", f"{source}VOLTage:RANGe:AUTO", True)
        self.switch("burst", f"{source}BURSt:STATe", False)
        self.choice("burst_mode", f"{source}BURSt:MODE", ("TRIGgered", "GATed"), "TRIG")
        self.number("phase", f"{source}BURSt:PHASe", 0.0, -360.0, 360.0)
        self.number("period", f"{source}BURSt:INTernal:PERiod", 0.01, 1e-6, 8000.0)
        self.on(f"{source}BURSt:NCYCles", set=self._set_cycles, get=self._tell_cycles)
        self._cycles = 1.0
        sources = ("IMMediate", "EXTernal", "TIMer", "BUS")
        self.choice("trigger", "TRIGger[1][:SEQuence]:SOURce", sources, "IMM")
        self.choice("trigger_slope", "TRIGger[1][:SEQuence]:SLOPe", slopes, "POS")
        self.number("trigger_delay", "TRIGger[1][:SEQuence]:DELay", 0.0, 0.0, 1000.0)
        self.on("TRIGger[1][:SEQuence][:IMMediate]", set=self._trigger)
        self.on("*TRG", set=self._bus_trigger)
        data = f"{source}DATA"
        self.on(f"{data}:ARBitrary[1]:DAC", set=self._store_codes, most=_MEMORY_POINTS)
        self.on(f"{data}:ARBitrary[1]", set=self._store_fractions, most=_MEMORY_POINTS)
        self.on(f"{data}:VOLatile:CLEar", set=self._clear_memory)
        self.on(f"{data}:VOLatile:FREE", get=lambda unit: f"+{self._free_points()}")
        self.on(f"{data}:VOLatile:CATalog", get=self._tell_catalogue)
        self.on(f"{data}:ATTRibute:POINts", get=self._tell_points)

    def reset(self) -> None:
        super().reset()
        self._load, self._vpp, self._offset, self._cycles = 50.0, 0.1, 0.0, 1.0
        self._selected = _BUILT_IN
        self._put_out()

    # ------------------------------------------------------------------- levels

    @property
    def _scale(self) -> float:
        """Volts into the amplifier's high impedance per volt displayed."""
        return 1.0 if self._load > 1e30 else (self._load + _SOURCE_OHM) / self._load

    @property
    def _limit(self) -> float:
        return _OPEN_LIMIT_V / self._scale

    @property
    def _smallest_vpp(self) -> float:
        return _OPEN_SMALLEST_VPP / self._scale

    @property
    def _high(self) -> float:
        return self._offset + self._vpp / 2

    @property
    def _low(self) -> float:
        return self._offset - self._vpp / 2

    def _tell(self, which: str):  # type: ignore[no-untyped-def]
        def tell(unit: Unit) -> str:
            if unit.arguments:
                return format_number(parse_number(unit.text(0), self._words(which)))
            return format_number(getattr(self, f"_{which}"))

        return tell

    def _words(self, which: str) -> dict[str, float]:
        limit, smallest = self._limit, self._smallest_vpp
        least = {"vpp": smallest, "high": -limit + smallest}.get(which, -limit)
        most = {"vpp": 2 * limit, "low": limit - smallest}.get(which, limit)
        default = {"vpp": 0.1, "offset": 0.0, "high": 0.05, "low": -0.05}[which]
        return {"MINimum": least, "MAXimum": most, "DEFault": default}

    def _set_amplitude(self, unit: Unit) -> None:
        asked = parse_number(unit.text(0), self._words("vpp"))
        most = 2 * self._limit * self._span()
        self._vpp = min(max(asked, self._smallest_vpp), most)
        room = self._limit - self._vpp / 2
        moved = abs(self._offset) > room + 1e-9
        self._offset = min(max(self._offset, -room), room)
        self._put_out()
        if not self._smallest_vpp - 1e-9 <= asked <= most + 1e-9:
            raise ScpiError(-222, "Data out of range; amplitude clipped to limit")
        if moved:
            raise ScpiError(-221, "Settings conflict; offset has been adjusted")

    def _set_offset(self, unit: Unit) -> None:
        asked = parse_number(unit.text(0), self._words("offset"))
        dc = self.state["function"] == "DC"
        room = self._limit if dc else self._limit - self._vpp / 2
        self._offset = min(max(asked, -room), room)
        self._put_out()
        if abs(asked) > room + 1e-9:
            raise ScpiError(-222, "Data out of range; offset clipped to limit")

    def _set_high(self, unit: Unit) -> None:
        asked = parse_number(unit.text(0), self._words("high"))
        self._set_levels(asked, self._low, "high")

    def _set_low(self, unit: Unit) -> None:
        asked = parse_number(unit.text(0), self._words("low"))
        self._set_levels(self._high, asked, "low")

    def _set_levels(self, high: float, low: float, asked: str) -> None:
        """The level asked for is taken as far as the limits go; the other one yields."""
        limit, smallest = self._limit, self._smallest_vpp
        errors = []
        if abs(high if asked == "high" else low) > limit + 1e-9:
            errors.append(ErrorEntry(-222, f"Data out of range; {asked} level clipped to limit"))
        high, low = min(high, limit), max(low, -limit)
        if high - low < smallest - 1e-9:
            if asked == "high":
                high = max(high, -limit + smallest)
                low = high - smallest
            else:
                low = min(low, limit - smallest)
                high = low + smallest
            other = "low" if asked == "high" else "high"
            errors.append(ErrorEntry(-221, f"Settings conflict; {other} level has been adjusted"))
        most = 2 * limit * self._span()
        if high - low > most + 1e-9:
            errors.append(ErrorEntry(-221, "Settings conflict; amplitude limited by the waveform"))
            high, low = (high, high - most) if asked == "high" else (low + most, low)
        self._vpp, self._offset = high - low, (high + low) / 2
        self._put_out()
        for error in errors:
            self.report(error)

    def _span(self) -> float:
        """The part of the converter that the waveform uses; 1 where that cannot matter."""
        if self.state["function"] != "ARB":
            return 1.0
        codes = self._codes()
        return float(int(codes.max()) - int(codes.min())) / (2 * _FULL_SCALE) or 1.0

    def _set_load(self, unit: Unit) -> None:
        words = {"MINimum": 1.0, "MAXimum": 10e3, "DEFault": 50.0}
        asked = parse_number(unit.text(0), words)
        if asked < 1.0 or 10e3 < asked < INFINITE:
            raise ScpiError(-222, "Data out of range; load not changed")
        before = self._scale
        self._load = asked
        self._vpp *= before / self._scale
        self._offset *= before / self._scale

    def _tell_load(self, unit: Unit) -> str:
        return format_number(self._load)

    # ------------------------------------------------------------------- memory

    def _codes(self) -> NDArray[np.int16]:
        if self._selected in self._arbs:
            return self._arbs[self._selected]
        rise = 1 - np.exp(-np.linspace(0, 5, 100))
        return np.rint(rise / rise[-1] * _FULL_SCALE).astype(np.int16)

    def _free_points(self) -> int:
        return _MEMORY_POINTS - sum(codes.size for codes in self._arbs.values())

    def _store_codes(self, unit: Unit) -> None:
        name, values = self._new_name(unit), self._values(unit, "i2")
        if values.size and (values.min() < -_FULL_SCALE - 1 or values.max() > _FULL_SCALE):
            raise ScpiError(-222, "Data out of range")
        self._store(name, values.astype(np.int16))

    def _store_fractions(self, unit: Unit) -> None:
        name, values = self._new_name(unit), self._values(unit, "f4")
        if values.size and np.abs(values).max() > 1.0:
            raise ScpiError(-222, "Data out of range")
        self._store(name, np.rint(values * _FULL_SCALE).astype(np.int16))

    def _values(self, unit: Unit, kind: str) -> NDArray[np.float64]:
        """The points after the name: one block, or numbers as text."""
        unit.text(1)
        if unit.arguments[1][:1] != b"#":
            if len(unit.arguments) > _ASCII_POINTS + 1:
                raise ScpiError(-223, "Too much data")
            return np.array([parse_number(unit.text(i)) for i in range(1, len(unit.arguments))])
        payload = block_argument(unit.arguments[1])
        order = "<" if self.state["border"] == "SWAP" else ">"
        if len(payload) % np.dtype(kind).itemsize:
            raise ScpiSyntaxError(-161, "Invalid block data")
        return np.frombuffer(payload, order + kind).astype(float)

    def _new_name(self, unit: Unit) -> str:
        name = arb_name(unit.text(0))
        if not re.fullmatch(r"[A-Z]\w{0,39}", name):
            raise ScpiError(-224, "Illegal parameter value; arb name")
        if name in self._arbs:
            raise ScpiError(786, "Specified arb waveform already exists")
        return name

    def _store(self, name: str, codes: NDArray[np.int16]) -> None:
        if codes.size < 8:
            raise ScpiError(-222, "Data out of range; arb has fewer than 8 points")
        if codes.size > _MEMORY_POINTS:
            raise ScpiError(-223, "Too much data")
        if codes.size > self._free_points():
            raise ScpiError(781, "Not enough memory to store new arb waveform")
        self._arbs[name] = codes

    def _clear_memory(self, unit: Unit) -> None:
        self._arbs.clear()
        self._selected = _BUILT_IN
        if self.state["function"] == "ARB":
            self._put_out()

    def _select(self, unit: Unit) -> None:
        name = arb_name(unit.text(0))
        if name not in self._arbs and name != _BUILT_IN:
            raise ScpiError(785, "Specified arb waveform does not exist")
        self._selected = name
        if self.state["function"] == "ARB":
            self._put_out()

    def _tell_selected(self, unit: Unit) -> str:
        if self._selected == _BUILT_IN:
            return f'"INT:\\BUILTIN\\{_BUILT_IN}.ARB"'
        return f'"{self._selected}"'

    def _tell_catalogue(self, unit: Unit) -> str:
        return ",".join(f'"{name}"' for name in (_BUILT_IN, *self._arbs))

    def _tell_points(self, unit: Unit) -> str:
        name = arb_name(unquote(unit.text(0))) if unit.arguments else self._selected
        if name not in self._arbs and name != _BUILT_IN:
            raise ScpiError(785, "Specified arb waveform does not exist")
        return f"+{self._arbs[name].size if name in self._arbs else self._codes().size}"

    # ------------------------------------------------------------------- output

    def changed(self, key: str) -> None:
        if key in ("function", "burst"):
            self._check_burst(key)
        if key in _ON_TERMINALS:
            self._put_out()

    def _check_burst(self, key: str) -> None:
        if self.state["function"] != "DC" or not self.state["burst"]:
            return
        self.state["burst"] = False
        raise_for = "burst turned off" if key == "function" else "DC cannot be bursted"
        self.report(ErrorEntry(-221, f"Settings conflict; {raise_for}"))

    @property
    def _idles(self) -> bool:
        return bool(self.state["burst"]) and self.state["trigger"] != "IMM"

    def _volts(self, fractions: NDArray[np.float64]) -> NDArray[np.float64]:
        sign = -1.0 if self.state["polarity"] == "INV" else 1.0
        volts = self._offset + sign * fractions * self._vpp / 2
        return np.clip(volts, -self._limit, self._limit) * self._scale

    def _waveform(self) -> tuple[NDArray[np.float64], float]:
        """One period, -1 to 1, and its sample rate."""
        function = self.state["function"]
        if function == "ARB":
            return self._codes() / _FULL_SCALE, self.state["sample_rate"]
        phase = np.arange(1000) / 1000
        rate = 1000 * self.state["frequency"]
        if function == "SIN":
            return np.sin(2 * np.pi * phase), rate
        if function in ("SQU", "PULS", "PRBS"):
            return np.where(phase < 0.5, 1.0, -1.0), rate
        if function == "NOIS":
            return np.random.default_rng(0).uniform(-1, 1, 1000), rate
        return 1 - 4 * np.abs(phase - 0.5), rate

    def _put_out(self) -> None:
        """Tell the plant what is on the terminals from now on; ends a burst."""
        t = self._wiring.now()
        self._burst_end = min(self._burst_end, t)
        if not self.state["output"]:
            self._rest_at(t, 0.0)
        elif self.state["function"] == "DC":
            self._rest_at(t, self._offset * self._scale)
        elif self._idles:
            self._rest_at(t, float(self._volts(self._waveform()[0][:1])[0]))
        else:
            fractions, rate = self._waveform()
            points = min(_FREE_RUN_POINTS, max(fractions.size, int(_FREE_RUN_S * rate)))
            if np.all(fractions == fractions[0]):
                self._rest_at(t, float(self._volts(fractions[:1])[0]))
            else:
                self._wiring.play(t, self._volts(np.resize(fractions, points)), rate)
                self._level = None

    def _rest_at(self, t: float, volts: float) -> None:
        if volts != self._level:
            self._wiring.set_level(t, volts)
            self._level = volts

    # ------------------------------------------------------------------- bursts

    def _set_cycles(self, unit: Unit) -> None:
        words = {"MINimum": 1.0, "MAXimum": 1e8, "DEFault": 1.0}
        asked = parse_number(unit.text(0), words)
        self._cycles = asked if asked >= INFINITE else float(round(min(max(asked, 1.0), 1e8)))
        if asked < 1 or 1e8 < asked < INFINITE:
            raise ScpiError(-222, "Data out of range; value clipped to limit")

    def _tell_cycles(self, unit: Unit) -> str:
        return format_number(self._cycles)

    def _bus_trigger(self, unit: Unit) -> None:
        if self.state["trigger"] != "BUS":
            raise ScpiError(-211, "Trigger ignored")
        self._trigger(unit)

    def _trigger(self, unit: Unit) -> None:
        t = self._wiring.now()
        if not self._idles or t < self._burst_end:
            raise ScpiError(-211, "Trigger ignored")
        fractions, rate = self._waveform()
        cycles = min(self._cycles, max(1.0, _FREE_RUN_POINTS // fractions.size))
        volts = self._volts(fractions)
        if cycles > 1:
            volts = np.tile(volts, int(cycles))
        self._burst_end = t + volts.size / rate
        if self.state["output"]:
            self._wiring.play(t, volts, rate)
            self._level = float(volts[0])
        if self.state["trigger_out"]:
            self._wiring.pulse(t, self.state["trigger_out_slope"] == "POS")

    async def complete(self) -> None:
        if self._burst_end > self._wiring.now():
            await pass_until(self.clock, self._burst_end)
