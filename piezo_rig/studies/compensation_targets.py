"""Where the actuator shall go in the compensation study. Displacement in um, 5 kSa/s."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

RATE = 5000.0
REST_S = 0.1
APPROACH_UM_PER_S = 30.0


def triangle(frequency_hz: float, cycles: int) -> FloatArray:
    """From 0 to 1 and back, whole cycles."""
    phase = np.arange(round(cycles * RATE / frequency_hz)) * frequency_hz / RATE
    return np.asarray(1.0 - np.abs(2.0 * np.mod(phase, 1.0) - 1.0))


def sine(frequency_hz: float, cycles: int) -> FloatArray:
    """From 0 to 1 and back, beginning at a turning point."""
    phase = np.arange(round(cycles * RATE / frequency_hz)) * frequency_hz / RATE
    return np.asarray(0.5 - 0.5 * np.cos(2.0 * np.pi * phase))


def way(begin_um: float, end_um: float) -> FloatArray:
    """A straight line at the approach's speed, without its end."""
    count = max(2, round(abs(end_um - begin_um) / APPROACH_UM_PER_S * RATE))
    return begin_um + (end_um - begin_um) * np.arange(count) / count


def from_rest(*parts: FloatArray) -> FloatArray:
    """Rest at 0, the way to the first part, and all parts in a row, which have to join."""
    rest = np.zeros(round(REST_S * RATE))
    return np.concatenate([rest, way(0.0, float(parts[0][0])), *parts])


def stairs(levels_um: tuple[float, ...], hold_s: float) -> FloatArray:
    """Holds at levels, and the ways between them."""
    hold = round(hold_s * RATE)
    parts = [np.full(hold, levels_um[0])]
    for begin, end in pairwise(levels_um):
        parts += [way(begin, end), np.full(hold, end)]
    return np.concatenate(parts)


def targets() -> dict[str, FloatArray]:
    """Every target by its name. Hysteresis keeps about 1 um: none goes back below that."""
    return {
        "triangle 0.5 Hz": from_rest(1.5 + 7.0 * triangle(0.5, 2)),
        "triangle 2 Hz": from_rest(1.5 + 7.0 * triangle(2.0, 4)),
        "triangle 10 Hz": from_rest(2.0 + 4.0 * triangle(10.0, 20)),
        "sine 0.5 Hz": from_rest(1.5 + 7.0 * sine(0.5, 2)),
        "sine 2 Hz": from_rest(1.5 + 7.0 * sine(2.0, 4)),
        "sine 20 Hz": from_rest(2.0 + 4.0 * sine(20.0, 40)),
        "staircase": from_rest(stairs((2.0, 3.5, 5.0, 6.5, 8.0, 6.5, 5.0, 3.5, 2.0), 0.4)),
        "minor loops": from_rest(
            8.0 - 5.0 * triangle(2.0, 1), 8.0 - 1.5 * triangle(4.0, 2),
            8.0 - 5.0 * triangle(2.0, 1),
            way(8.0, 4.0), 4.0 + 2.0 * sine(4.0, 3), 4.0 + 1.0 * triangle(8.0, 4),
        ),
    }  # fmt: skip
