"""What the output of a 33500B is doing, told from its settings alone.

The instrument has no query for the volts on its terminals. Between bursts they
follow from the settings, provided that the waveform's first point is known,
which it is for the waveforms that this program's driver uploads.
"""

from __future__ import annotations

from typing import ClassVar

from drivers.dac_codes import SMALLEST_SPAN_V
from drivers.scpi_values import INFINITE, arb_name, parse_boolean, parse_number, same_word

OWN_PREFIX = "PZ"
"""Begins the names of waveforms whose first point is LOW."""
NARROW_V = SMALLEST_SPAN_V
"""What HIGH and LOW are apart while nothing is to be played."""
REST_NAME = "PZREST"
"""The waveform that is selected but never played."""


class OutputState:
    """What the generator was doing when it was looked at."""

    QUERIES: ClassVar[dict[str, str]] = {
        "output": "OUTP1?",
        "load": "OUTP1:LOAD?",
        "function": "SOUR1:FUNC?",
        "arb": "SOUR1:FUNC:ARB?",
        "sample_rate": "SOUR1:FUNC:ARB:SRAT?",
        "high": "SOUR1:VOLT:HIGH?",
        "low": "SOUR1:VOLT:LOW?",
        "offset": "SOUR1:VOLT:OFFS?",
        "burst": "SOUR1:BURS:STAT?",
        "burst_mode": "SOUR1:BURS:MODE?",
        "cycles": "SOUR1:BURS:NCYC?",
        "trigger": "TRIG1:SOUR?",
    }

    def __init__(self, answers: list[str]) -> None:
        said = dict(zip(self.QUERIES, answers, strict=True))
        self.on = parse_boolean(said["output"])
        load = parse_number(said["load"], {"INFinity": INFINITE})
        if load <= 0.0:
            raise ValueError(f"a load of {load:g} ohm")
        # Levels are told for the load setting; the amplifier's input is a high impedance.
        self.scale = 1.0 if load > 1e30 else (load + 50.0) / load
        self.function = said["function"]
        self.arb = said["arb"]
        self.sample_rate = parse_number(said["sample_rate"])
        self.high, self.low, self.offset = (
            self.scale * parse_number(said[key]) for key in ("high", "low", "offset")
        )
        self.cycles = parse_number(said["cycles"])
        self.is_dc = self.function.strip('"').upper() == "DC"
        idles = (
            parse_boolean(said["burst"])
            and same_word("TRIG", said["burst_mode"])
            and same_word("BUS", said["trigger"])
            and self.cycles < 1e6
        )
        # An idle burst of millivolts: the level is LOW, whatever the waveform's first point.
        self.is_narrow = idles and same_word("ARB", self.function) and (
            self.high - self.low <= NARROW_V + 1e-3
        )
        name = arb_name(self.arb)
        # The rest waveform stays within a few millivolts of LOW whether it is burst or not.
        ours = (idles and name.startswith(OWN_PREFIX)) or name == REST_NAME
        self.is_ours = same_word("ARB", self.function) and ours

    @property
    def level(self) -> float | None:
        """Volts on the terminals between bursts; None when they cannot be told."""
        if not self.on:
            return 0.0
        if self.is_dc:
            return self.offset
        return self.low if self.is_ours or self.is_narrow else None

    def describe(self) -> str:
        state = "on" if self.on else "off"
        arb = f" {self.arb}" if same_word("ARB", self.function) else ""
        return f"output {state}, {self.function}{arb}, {self.low:g} to {self.high:g} V"
