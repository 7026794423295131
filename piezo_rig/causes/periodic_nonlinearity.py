"""Periodic nonlinearity: an error of the interferometer that repeats every half wavelength.

Physics: polarisation mixing and ghost beams add a vector to the interference signal, so that the
phase read off it errs periodically, once per lambda/2 = 316.4 nm of displacement (and, weaker,
twice). C.-M. Wu and R. D. Deslattes, Appl. Opt. 37 (1998) 6696.

Shows as: a ripple over displacement that neither direction nor speed changes.

Remedy: Align the interferometer's polarisation, or have its quadrature corrected; positions within
half a wavelength are off by the amplitude.

Plausible: 0.1-5 nm.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import Cause, Context, FloatArray
from piezo_rig.chain.placed import Placed
from piezo_rig.chain.stage import Parameter, Signal, Stage

HALF_WAVE_UM = 0.3164


class PeriodicNonlinearity(Cause):
    """Sine and cosine parts (nm) of the first and second order over displacement."""

    id = "periodic-nonlinearity"
    place = "sensor"
    like_no_other = True
    together = True
    meanings: ClassVar[Mapping[str, str]] = {
        "amplitude": "of the error within a fringe",
        "sine": "in-phase part of the error within a fringe",
        "cosine": "quadrature part of it",
        "sine_2": "in-phase part at half the period",
        "cosine_2": "quadrature part at half the period",
    }
    units: ClassVar[Mapping[str, str]] = {
        "sine": "nm",
        "cosine": "nm",
        "sine_2": "nm",
        "cosine_2": "nm",
    }

    def act(self, signal: Signal) -> Signal:
        angle = 2.0 * np.pi / HALF_WAVE_UM * _on_the_scale(signal)
        error = self["sine"] * np.sin(angle) + self["cosine"] * np.cos(angle)
        if self["sine_2"] or self["cosine_2"]:
            error = error + self["sine_2"] * np.sin(2 * angle)
            error = error + self["cosine_2"] * np.cos(2 * angle)
        return signal.with_displacement(signal.displacement_um + 1e-3 * error)

    def carry(self, signal: Signal, changes: FloatArray) -> FloatArray:
        """By the slope of the error. Base columns that hardly differ from each other are large, and
        differences of finite changes would leave a ripple of any size in what they differ by.
        """
        angle = 2.0 * np.pi / HALF_WAVE_UM * _on_the_scale(signal)
        slope = self["sine"] * np.cos(angle) - self["cosine"] * np.sin(angle)
        slope += 2.0 * (self["sine_2"] * np.cos(2 * angle) - self["cosine_2"] * np.sin(2 * angle))
        slope *= 1e-3 * 2.0 * np.pi / HALF_WAVE_UM
        return np.asarray(changes + slope * _moved_on_the_scale(signal, changes))

    @classmethod
    def trials(cls, context: Context) -> list[Stage]:
        if context.travel_um < HALF_WAVE_UM:
            return []
        nothing = dict.fromkeys(cls.units, 0.0)
        return [cls.of(None, **(nothing | {name: 0.1})) for name in cls.units]

    def reported(self, covariance: FloatArray) -> dict[str, Parameter]:
        a, b = self["sine"], self["cosine"]
        size = float(np.hypot(a, b))
        way = np.array([a, b]) / size if size else np.zeros(2)
        spread = float(np.sqrt(max(float(way @ covariance[:2, :2] @ way), 0.0)))
        low = max(size - 1.96 * spread, 0.0)
        return {"amplitude": Parameter(size, "nm", (low, size + 1.96 * spread))}


def _on_the_scale(signal: Signal) -> FloatArray:
    """Displacement (n,) as the interferometer's own scale reads it, um."""
    x, placed = signal.displacement_um, Placed.of(signal)
    if placed is None:
        return x
    off = placed.scale_um - placed.means(x)
    return np.asarray(x + placed.spread(np.where(np.isfinite(off), off, 0.0)))


def _moved_on_the_scale(signal: Signal, changes: FloatArray) -> FloatArray:
    """What changes (k, n) of the displacement are on that scale: a recording whose place there is
    known by its mean stays where it is on the average.
    """
    placed = Placed.of(signal)
    if placed is None:
        return changes
    known = np.isfinite(placed.scale_um)
    means = np.array([np.where(known, placed.means(row), 0.0) for row in changes])
    return np.asarray(changes - np.array([placed.spread(each) for each in means]))
