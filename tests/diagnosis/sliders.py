"""An actuator of springs and sliders from rest, for recordings that tests make themselves."""

import numpy as np

from piezo_rig.run_file.sweep import Sweep


def play(volts: np.ndarray, limits: np.ndarray, share: float) -> np.ndarray:
    """Displacement, um: 0.08 um/V of a spring, and ``share`` of every slider that lags by a limit.

    Clipped from sample to sample; the program's kernel looks segments up in curves.
    """
    out, x = np.empty(volts.size), np.zeros(limits.size)
    for k, v in enumerate(volts - volts[0]):
        x = np.clip(x, v - limits, v + limits)
        out[k] = x.sum()
    return 0.08 * (volts - volts[0]) + share * out


def recorded(
    drive: np.ndarray, seen: np.ndarray, rate: float, history: str = "virgin", number: int = 1,
    condition: str = "", repeat: int = 1,
) -> Sweep:  # fmt: skip
    """A recording in volts of drive and um of displacement, as if it was imported."""
    return Sweep(
        f"sweep_{number:04d}", drive, seen, rate, 1.0, 0.0, 1.0, 1, 0.0, condition, repeat, history,
        0.0, "IMPORTED",
    )  # fmt: skip
