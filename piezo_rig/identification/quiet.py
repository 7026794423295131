"""A drive that was recorded with noise, without it, where the actuator did not follow the noise.

A digitizer's noise on the drive is no motion of the stack, but a model that is driven by it moves.
Whatever smooths the drive then seems to be there: a lag and a delay that cancel, or a limit just
within the noise.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import dead_band
from piezo_rig.chain.half_loops import noise

FloatArray = NDArray[np.float64]
WIDTHS = (5, 9, 17, 33, 65)  # samples of a window
ABOUT, BEFORE, AFTER = 0.5, 1.0, 0.0  # where in its window a sample lies
FITS = ((ABOUT, 2), (BEFORE, 1), (BEFORE, 2), (AFTER, 1), (AFTER, 2))  # and the polynomial's order
SURE = 3.0  # standard deviations by which two windows may disagree
LEAST = 1e-5  # of the drive's range: less is how its numbers are rounded
ROUNDED = 0.5  # of a digitizer's step: less is rounding, which repeats from sample to sample
ONCE = 0.9  # of the samples: values of noise come back as rarely
COUNTED, ON_STEPS = 20.0, 0.05  # steps between neighbours that are looked at; mean share beside
FOLLOWS = 0.5  # of the mean displacement per volt: noise that the actuator follows so is a drive


@lru_cache(maxsize=64)
def _weights(width: int, place: float, order: int) -> tuple[FloatArray, int, float]:
    """Of a window's samples, where the estimate lies, and what is left of white noise in it."""
    at = round(place * (width - 1))
    powers = ((np.arange(width) - at) / width)[:, None] ** np.arange(order + 1)
    weights = np.linalg.pinv(powers)[0]  # of a polynomial's value at 0 (Savitzky and Golay 1964)
    return weights, at, float(np.sqrt(np.sum(weights**2)))


def _step_v(drive_v: FloatArray, span: float) -> float:
    """Between neighbouring values of a drive, volts; 0 where there are no steps.

    Values of few samples lie far apart, steps or none. Where hardly any comes back, what lies
    between neighbours must be so many times what lies between the nearest.
    """
    values = np.unique(drive_v)
    apart = np.diff(values)
    apart = apart[apart > 1e-9 * span]
    if not apart.size:
        return 0.0
    if values.size < ONCE * drive_v.size:
        return float(np.median(apart))
    times = apart / apart.min()
    times = times[times < COUNTED]
    off = float(np.mean(np.abs(times - np.round(times))))
    return float(apart.min()) if off < ON_STEPS else 0.0


def quiet(drive_v: FloatArray, displacement_um: FloatArray) -> tuple[FloatArray, float]:
    """The drive (n,) without its noise, and that noise, volts; as it is, and 0, where it is clean.

    Lines and parabolas are fitted to windows about, before and after each sample, the widest that
    no narrower one contradicts (the intersection of confidence intervals; A. Goldenshluger,
    A. Nemirovski, Math. Methods Statist. 6 (1997) 135), and the surest of them is taken: at a
    corner the ones before or behind it, at a leap the sample itself.

    Parameters
    ----------
    displacement_um : shape (n,); says whether the actuator followed what looks like noise
    """
    n = drive_v.size
    if n < WIDTHS[-1] or dead_band(drive_v) == 0.0:
        return drive_v, 0.0
    sigma, span = noise(drive_v), float(np.ptp(drive_v))
    if sigma < max(LEAST * span, ROUNDED * _step_v(drive_v, span)):
        return drive_v, 0.0
    both = np.array([drive_v, displacement_um])
    smooth, left = both.copy(), np.ones(n)
    for place, order in FITS:
        low, high = drive_v - SURE * sigma, drive_v + SURE * sigma
        agrees = np.ones(n, bool)
        for width in WIDTHS:
            weights, at, own = _weights(width, place, order)
            begin, end = at, n - width + 1 + at
            agrees[:begin] = agrees[end:] = False
            fit = np.array([np.correlate(row, weights, "valid") for row in both])
            low[begin:end] = np.maximum(low[begin:end], fit[0] - SURE * sigma * own)
            high[begin:end] = np.minimum(high[begin:end], fit[0] + SURE * sigma * own)
            agrees &= low <= high
            better = agrees[begin:end] & (own < left[begin:end])
            smooth[:, begin:end][:, better] = fit[:, better]
            left[begin:end][better] = own
    off_v, off_um = both - smooth
    power = float(off_v @ off_v)
    slope = float(np.ptp(displacement_um)) / span
    if power == 0.0 or float(off_v @ off_um) > FOLLOWS * slope * power:
        return drive_v, 0.0
    return smooth[0], sigma
