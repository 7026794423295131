"""The noise: its spectrum, from what repeats disagree by, and a filter that makes it white.

The spectrum is a smooth curve over the logarithm of the frequency, fitted to the periodogram by
Whittle likelihood (P. Whittle, Ark. Mat. 2 (1953) 423) and raised by some standard errors, so
that low frequencies, of which every recording has few, are not trusted too much. The filter is
causal, with zeros before the first sample: the minimum-phase inverse of the spectrum, from its
cepstrum (A. Oppenheim, R. Schafer, Discrete-Time Signal Processing, ch. 13).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

FloatArray = NDArray[np.float64]
RAISED = 1.5  # standard errors
PER_DECADE = 4  # corners of the smooth curve
BINS = 80
STEEPEST = -2.0  # power of the frequency that noise may rise with towards low ones
AT_ONCE = 8  # rows that are filtered together: more do not fit the processor's cache
LEAST = 1e-12  # of the largest periodogram value: exact data have no noise


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Variance per sample as a curve over log frequency.

    Attributes
    ----------
    frequency : shape (k,), corners, in cycles per sample
    log_power : shape (k,), um^2 per sample (white noise of variance v has power v everywhere)
    error : shape (k,), its standard error
    """

    frequency: FloatArray
    log_power: FloatArray
    error: FloatArray

    def power(self, frequency: FloatArray, raised: float = RAISED) -> FloatArray:
        x = np.log(np.maximum(frequency, self.frequency[0]))
        curve = self.log_power + raised * self.error
        return np.exp(np.interp(x, np.log(self.frequency), curve))

    def onward(self, first: int) -> Spectrum:
        """With what is below a corner gone on to from those above it: nothing is known of it.

        As a power of the frequency, the one over the next decade; noise does not fall towards low
        frequencies.
        """
        x = np.log(self.frequency)
        known = slice(first, first + PER_DECADE + 1)
        if first == 0 or x[known].size < 3:
            return self
        weight = self.error[known] ** -2.0
        mean = float(weight @ x[known] / weight.sum())
        off = x[known] - mean
        level = float(weight @ self.log_power[known] / weight.sum())
        slope = float(weight @ (off * self.log_power[known]) / (weight @ off**2))
        slope = float(np.clip(slope, STEEPEST, 0.0))
        away = x[:first] - mean
        error = np.sqrt(1.0 / weight.sum() + away**2 / (weight @ off**2))
        return Spectrum(
            self.frequency,
            np.concatenate([level + slope * away, self.log_power[first:]]),
            np.concatenate([error, self.error[first:]]),
        )

    @property
    def rms_um(self) -> float:
        """Of one recording."""
        grid = np.linspace(0.0, 0.5, 2001)[1:]
        return float(np.sqrt(np.mean(self.power(grid, 0.0))))

    def scaled(self, factor: FloatArray | float) -> Spectrum:
        return Spectrum(self.frequency, self.log_power + np.log(factor), self.error)


def spectrum_of(
    parts: Sequence[FloatArray], freedom: float = 1.0, least: float = 1e-18
) -> Spectrum:
    """Spectrum of noise realisations.

    Parameters
    ----------
    parts : noise (n,) of several stretches, scaled so that its variance is that of one recording
    least : um^2 per sample that is taken for noise even where there is none
    freedom : independent realisations per part, (R - 1) / R for deviations from a mean
    """
    longest = max(p.size for p in parts)
    low, high = 1.0 / longest, 0.5
    edges = np.geomspace(low / 1.5, high * 1.0001, BINS + 1)
    total, count = np.zeros(BINS), np.zeros(BINS)
    for part in parts:
        if part.size < 16:
            continue
        n = part.size
        window = np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2
        x = (part - part.mean()) * window
        power = np.abs(fft.rfft(x)) ** 2 / float(window @ window)
        f = np.arange(power.size) / n
        keep = (f > 0.5 / n) & (f < 0.5)
        where = np.clip(np.searchsorted(edges, f[keep]) - 1, 0, BINS - 1)
        np.add.at(total, where, power[keep])
        np.add.at(count, where, 1.0)
    seen = count > 0
    mean = total[seen] / count[seen]
    f = np.sqrt(edges[1:] * edges[:-1])[seen]
    mean = np.maximum(mean, max(LEAST * float(mean.max()), least))
    # neighbouring bins of a tapered periodogram are correlated: fewer are independent
    weight = np.maximum(count[seen] * freedom / 1.9, 0.3)
    return _smooth(f, mean, weight, low, high)


def _smooth(
    f: FloatArray, mean: FloatArray, weight: FloatArray, low: float, high: float
) -> Spectrum:
    corners = max(4, int(np.ceil(PER_DECADE * np.log10(high / low))) + 1)
    knots = np.geomspace(low, high, corners)
    x, at = np.log(f), np.log(knots)
    basis = np.array([np.interp(x, at, row) for row in np.eye(corners)]).T
    bend = np.diff(np.eye(corners), 2, axis=0)
    penalty = 0.5 * bend.T @ bend
    c = np.linalg.solve(
        basis.T @ (weight[:, None] * basis) + penalty + 1e-9 * np.eye(corners),
        basis.T @ (weight * np.log(mean)),
    )
    fisher = basis.T @ (weight[:, None] * basis) + penalty
    for _ in range(30):
        ratio = mean * np.exp(-np.clip(basis @ c, -80, 80))
        ratio = np.minimum(ratio, 1e3)
        gradient = basis.T @ (weight * (ratio - 1.0)) - penalty @ c
        step = np.linalg.solve(
            basis.T @ ((weight * np.maximum(ratio, 0.5))[:, None] * basis)
            + penalty
            + 1e-9 * np.eye(corners),
            gradient,
        )
        c = c + np.clip(step, -2.0, 2.0)
        if np.max(np.abs(step)) < 1e-6:
            break
    error = np.sqrt(np.maximum(np.diag(np.linalg.inv(fisher + 1e-9 * np.eye(corners))), 0.0))
    return Spectrum(knots, c, error)


class Whitener:
    """Filters that make noise of one spectrum white with variance 1; one per length, kept."""

    def __init__(self, spectrum: Spectrum, raised: float = RAISED) -> None:
        self.spectrum, self.raised = spectrum, raised
        self._filters: dict[int, tuple[int, FloatArray]] = {}
        self._ones: dict[int, FloatArray] = {}
        curve = spectrum.log_power + raised * spectrum.error
        self._even = float(np.exp(-0.5 * curve[0])) if np.ptp(curve) == 0.0 else None

    def _filter(self, n: int) -> tuple[int, FloatArray]:
        if n not in self._filters:
            size = int(fft.next_fast_len(2 * n, real=True))
            size += size % 2
            grid = np.arange(size // 2 + 1) / size
            half = -0.5 * np.log(self.spectrum.power(grid, self.raised))
            cepstrum = fft.irfft(half, size)
            fold = np.zeros(size)
            fold[0] = 1.0
            fold[1 : size // 2] = 2.0
            fold[size // 2] = 1.0
            response = np.exp(fft.rfft(cepstrum * fold))
            taps = fft.irfft(response, size)
            taps[n:] = 0.0
            self._filters[n] = (size, fft.rfft(taps))
        return self._filters[n]

    def __call__(self, values: NDArray[Any]) -> FloatArray:
        """Filtered along the last axis; shape (..., n), in single precision if the values are."""
        if self._even is not None:
            return self._even * values
        n = values.shape[-1]
        size, response = self._filter(n)
        if values.dtype == np.float32:
            response = response.astype(np.complex64)
        out = np.empty(values.shape, values.dtype)
        rows, filtered = values.reshape(-1, n), out.reshape(-1, n)
        for begin in range(0, rows.shape[0], AT_ONCE):
            some = slice(begin, begin + AT_ONCE)
            turned = fft.rfft(rows[some], size, axis=-1)
            turned *= response
            filtered[some] = fft.irfft(turned, size, axis=-1, overwrite_x=True)[:, :n]
        return out

    def ones(self, n: int) -> FloatArray:
        """A constant of 1, filtered, shape (n,); not to be written to."""
        if n not in self._ones:
            self._ones[n] = self(np.ones(n))
        return self._ones[n]

    def coloured(self, n: int, rng: np.random.Generator) -> FloatArray:
        """A realisation of the noise, shape (n,); stationary."""
        size = int(fft.next_fast_len(4 * n, real=True))
        grid = np.arange(size // 2 + 1) / size
        power = self.spectrum.power(grid, self.raised)
        return fft.irfft(fft.rfft(rng.standard_normal(size)) * np.sqrt(power), size)[:n]
