"""Noise as a sum of first-order processes and white noise, drawn and whitened exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.scoring import kernels

FloatArray = NDArray[np.float64]


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
