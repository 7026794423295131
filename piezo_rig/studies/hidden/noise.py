"""What the sensor adds, by name.

A sum of first-order processes with time constants evenly spread over the decades has a spectrum
of 1/f between their corner frequencies.
"""

from __future__ import annotations

import numpy as np

from piezo_rig.scoring.noise import Noise

LOWEST_HZ, PER_DECADE = 0.02, 2.5


def _pink(rate: float) -> Noise:
    high = 0.3 * rate
    count = round(PER_DECADE * np.log10(high / LOWEST_HZ)) + 1
    corners = np.geomspace(LOWEST_HZ, high, count)
    sigmas = np.full(count, 3e-3 / np.sqrt(count))
    return Noise(np.exp(-2.0 * np.pi * corners / rate), sigmas, 1e-3)


def noise_of(kind: str, rate: float) -> Noise:
    """``white`` 2 nm, ``ar`` 5 nm with 0.95, ``1/f`` 3 nm and 1 nm white, or ``none``."""
    nothing = np.zeros(0)
    if kind == "1/f":
        return _pink(rate)
    if kind == "ar":
        return Noise(np.array([0.95]), np.array([5e-3]), 0.0)
    if kind == "white":
        return Noise(nothing, nothing, 2e-3)
    if kind == "none":
        return Noise(nothing, nothing, 0.0, 2e-3)
    raise ValueError(f"noise {kind!r} is not one of {', '.join(NOISES)}")


NOISES = ("white", "ar", "1/f", "none")
