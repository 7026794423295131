"""The drivers by the names that a rig's config gives them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from drivers.amplifier import Amplifier, ManualAmplifier, ThorlabsMDT69x
from drivers.clock import Clock
from drivers.digitizer import Digitizer, KeysightL4532A
from drivers.nidaqmx_bench import NidaqmxInput, NidaqmxOutput
from drivers.transport import Transport
from drivers.waveform_dac import Keysight33500B, WaveformDac

CARD = "nidaqmx"
"""A card is waveform DAC and digitizer in one, on one line."""
AMPLIFIERS: dict[str, Callable[[Transport, float, float], Any]] = {
    "thorlabs_mdt69x": ThorlabsMDT69x,
}
"""Amplifiers with a link; called with line, set voltage and voltage limit."""
MANUAL = "manual"


def make_dac(driver: str, line: Transport, clock: Clock) -> WaveformDac:
    """The waveform DAC on its line."""
    return NidaqmxOutput(line, clock) if driver == CARD else Keysight33500B(line)


def make_digitizer(
    driver: str, line: Transport | None, dac: WaveformDac, clock: Clock, channel: str = "",
    number: int = 2,
) -> Digitizer:
    """The digitizer.

    Parameters
    ----------
    line : its own; None for a card, whose line is that of ``dac``
    channel : of a card, the sensor's physical one; ``number`` is its number in the rig's config
    """
    if isinstance(dac, NidaqmxOutput):
        return NidaqmxInput(dac, channel, number)
    assert line is not None
    return KeysightL4532A(line, clock)


def make_amplifier(
    driver: str, line: Callable[[], Transport], set_voltage_v: float, limit_v: float, serial: str
) -> Amplifier:
    """The amplifier; ``line`` opens its line, where it has one."""
    if driver == MANUAL:
        return ManualAmplifier(set_voltage_v, limit_v, serial)
    made: Amplifier = AMPLIFIERS[driver](line(), set_voltage_v, limit_v)
    return made
