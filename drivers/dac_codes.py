"""Sixteen-bit codes of a sweep's waveform: what may be uploaded, and at which levels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FULL_SCALE = 32767
FEWEST_POINTS = 8
MEMORY_POINTS = 1_000_000
SMALLEST_SPAN_V = 0.010
"""A little more than what the generator can set between HIGH and LOW."""


def checked_codes(codes: NDArray[np.int16]) -> NDArray[np.int16]:
    """The codes, contiguous; ValueError unless they begin and end at rest and fit the memory."""
    codes = np.ascontiguousarray(codes, dtype=np.int16)
    if not FEWEST_POINTS <= codes.size <= MEMORY_POINTS:
        raise ValueError(f"{codes.size} points, not {FEWEST_POINTS} to {MEMORY_POINTS}")
    if codes[0] != -FULL_SCALE or codes[-1] != -FULL_SCALE:
        raise ValueError("a waveform begins and ends at rest, code -32767")
    if codes.min() < -FULL_SCALE:
        raise ValueError("code -32768 is below full scale")
    return codes


def fitted_codes(
    codes: NDArray[np.int16], low_v: float, high_v: float
) -> tuple[NDArray[np.int16], float]:
    """The same volts, spanning the converter on at least the span that can be set.

    The generator limits the amplitude of waveforms that do not span its converter.
    """
    if high_v < low_v:
        raise ValueError(f"high {high_v:g} V is below low {low_v:g} V")
    top = int(codes.max())
    if top == -FULL_SCALE:
        return codes, low_v + SMALLEST_SPAN_V
    peak_v = low_v + (high_v - low_v) * (top + FULL_SCALE) / (2 * FULL_SCALE)
    span_v = max(peak_v - low_v, SMALLEST_SPAN_V)
    stretch = (high_v - low_v) / span_v
    if stretch == 1.0:
        return codes, high_v
    stretched = np.rint((codes.astype(float) + FULL_SCALE) * stretch) - FULL_SCALE
    return stretched.astype(np.int16), low_v + span_v
