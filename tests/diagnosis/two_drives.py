"""A session of two drives with repeats, whose gain a test lets wander."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from piezo_rig.run_file.sweep import Sweep
from tests.diagnosis.sliders import play

RATE, NOISE_UM = 1000.0, 2e-3
LIMITS = np.linspace(0.5, 30.0, 30)


def noise(rng: np.random.Generator, n: int, colour: str) -> np.ndarray:
    white = rng.standard_normal(n)
    if colour == "white":
        return white
    ar = lfilter([1.0], [1.0, -0.95], rng.standard_normal(n + 500))[500:]
    return 0.5 * white + 0.25 * ar


def session(seed: int, colour: str, gain, samples: int = 4000) -> list[Sweep]:
    """Two drives, three times each; ``gain`` : of recording and time, what the sensor shows."""
    rng, out, time = np.random.default_rng(seed), [], np.arange(samples) / RATE
    for number in range(6):
        top = (70.0, 45.0)[number % 2]
        volts = top * (1.0 - np.abs(2.0 * ((1.5 * time) % 1.0) - 1.0))
        moved = play(volts, LIMITS, 0.0016) * (1.0 + gain(number, 60.0 * number + time))
        out.append(Sweep(
            f"sweep_{number + 1:04d}", volts, moved + NOISE_UM * noise(rng, time.size, colour),
            RATE, 1.0, 0.0, 1.0, 1, 0.0, f"to {top:g} V", number // 2 + 1, "virgin",
            60.0 * number, "SIMULATED",
        ))  # fmt: skip
    return out
