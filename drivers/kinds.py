"""The drivers by the names that a rig's config gives them."""

from __future__ import annotations

from drivers.clock import Clock
from drivers.digitizer import Digitizer, KeysightL4532A
from drivers.nidaqmx_bench import NidaqmxInput, NidaqmxOutput
from drivers.transport import Transport
from drivers.waveform_dac import Keysight33500B, WaveformDac

WAVEFORM_DACS = ("keysight_33500b", "nidaqmx")
DIGITIZERS = ("keysight_l4532a", "nidaqmx")
CARD = "nidaqmx"
"""A card is waveform DAC and digitizer in one, on one line."""


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
