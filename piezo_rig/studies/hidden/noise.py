"""What the sensor adds: sums of first-order processes and white noise, whitened exactly.

A sum of first-order processes with time constants evenly spread over the decades has a spectrum
of 1/f between their corner frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.studies.hidden import kernels

FloatArray = NDArray[np.float64]
LOWEST_HZ, PER_DECADE = 0.02, 2.5


@dataclass(frozen=True, eq=False)
class Noise:
    """AR(1) processes of standard deviations ``sigmas`` um and ``white`` um on top.

    ``decays`` : shape (k,), correlation of neighbouring samples
    ``reference_um`` : white noise that an oracle reckons with where there is none
    """

    decays: FloatArray
    sigmas: FloatArray
    white: float
    reference_um: float = 0.0

    @property
    def rms_nm(self) -> float:
        return 1e3 * float(np.sqrt(self.white**2 + np.sum(self.sigmas**2)))

    def drawn(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Noise of one recording, um, shape (n,)."""
        out = self.white * rng.standard_normal(n)
        for decay, sigma in zip(self.decays, self.sigmas, strict=True):
            out += kernels.autoregressive(
                rng.standard_normal(n), rng.standard_normal(), float(decay), float(sigma)
            )
        return out

    def whitened(self, columns: FloatArray) -> FloatArray:
        """Columns (n, m) in units of the noise, uncorrelated."""
        white = self.white**2 + self.reference_um**2
        if not self.decays.size:
            return columns / np.sqrt(white)
        return kernels.innovations(
            np.ascontiguousarray(columns), self.decays, self.sigmas**2, white
        )


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
