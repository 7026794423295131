"""The four kinds of noise: as tables of the plant, and as the oracle has to know them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezo_rig.challenge.hiding import Settings
from piezo_rig.scoring.noise import Noise

FloatArray = NDArray[np.float64]
NOISES = ("white", "ar", "1/f", "mixed")
STEP_UM = 15.48 * 20.0 / 2**16  # of the converter behind the sensor's analogue output
# The plant's 1/f noise: octaves of straight lines between independent knots.
FINEST_KNOT_S, OCTAVES, IN_A_SWEEP = 2e-4, 18, 14.6
PLANT: dict[str, Settings] = {
    "white": {"white_noise": {"on": True, "rms": 2.0}},
    "ar": {"ar_noise": {"on": True, "rms": 5.0, "coefficient": 0.95}},
    "1/f": {"one_over_f_noise": {"on": True, "rms": 3.0},
            "white_noise": {"on": True, "rms": 1.0}},
    "mixed": {"white_noise": {"on": True, "rms": 2.0},
              "one_over_f_noise": {"on": True, "rms": 2.0}},
}  # fmt: skip
SILENT: Settings = {
    **{name: {"on": False} for name in ("white_noise", "one_over_f_noise", "ar_noise")},
    "quantisation": {"on": False},
}


def noise_of(kind: str, rate: float) -> Noise:
    """The noise of a recording at ``rate``, with the converter's steps as white noise.

    An octave of knots T apart has the variance 2/3 of a knot's and the correlation time of a
    first-order process with 3/4 T; that stands in for it, and for an octave finer than the
    samples, white noise.
    """
    tables = PLANT[kind]
    white = STEP_UM**2 / 12.0
    decays: list[float] = []
    sigmas: list[float] = []
    if "white_noise" in tables:
        white += (1e-3 * tables["white_noise"]["rms"]) ** 2
    if "ar_noise" in tables:
        decays.append(tables["ar_noise"]["coefficient"] ** (5000.0 / rate))
        sigmas.append(1e-3 * tables["ar_noise"]["rms"])
    if "one_over_f_noise" in tables:
        each = 1e-3 * tables["one_over_f_noise"]["rms"] / np.sqrt(IN_A_SWEEP)
        for octave in range(OCTAVES):
            tau = 0.75 * FINEST_KNOT_S * 2.0**octave
            if tau * rate < 0.3:
                white += each**2
            else:
                decays.append(float(np.exp(-1.0 / (tau * rate))))
                sigmas.append(float(each))
    return Noise(np.array(decays), np.array(sigmas), float(np.sqrt(white)))
