"""The amplitude spectrum of single recordings in clock time, where lines of the mains show."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes.mains_hum import ORDERS
from piezo_rig.report.residuals import Residuals
from piezo_rig.report.svg import Curve, Panel, Plot

FloatArray = NDArray[np.float64]
POINTS = 420
LOWEST_HZ = 8.0  # below it is what the drive does
BEYOND = 1.4  # times the highest line


def hum_plot(residuals: Residuals, rungs: tuple[int, int], fundamental: float) -> Plot:
    """Spectra before and after the lines were taken out."""
    highest = min(BEYOND * ORDERS[-1] * fundamental, 0.5 * residuals.groups[0].rate)
    panels = [
        Panel(title, [Curve("all recordings", *spectrum(residuals, rung, highest))])
        for title, rung in zip(("before: as recorded", "after: lines taken out"), rungs,
                               strict=True)
    ]  # fmt: skip
    marks = [(k * fundamental, f"{k * fundamental:.0f} Hz") for k in ORDERS]
    return Plot(
        panels, "frequency (Hz)", "amplitude (nm peak)",
        "Amplitude spectrum of what single recordings have of their own, before and after the "
        "mains lines were taken out.",
        x_unit="Hz", marks=marks,
    )  # fmt: skip


def spectrum(
    residuals: Residuals, rung: int, highest_hz: float
) -> tuple[FloatArray, FloatArray]:
    """Hz, and nm (peak) of what recordings have of their own, root mean square over recordings.

    With repeats that is what they differ by: what is locked to the drive is the same in all.
    """
    grid = np.linspace(min(LOWEST_HZ, 0.2 * highest_hz), highest_hz, POINTS + 1)
    power, count = np.zeros(POINTS), np.zeros(POINTS)
    for g in range(len(residuals.samples)):
        rows = residuals.single(rung, g)
        if rows.shape[0] > 1:
            # the mean holds a share of every recording's own
            rows = (rows - rows.mean(axis=0)) * np.sqrt(rows.shape[0] / (rows.shape[0] - 1.0))
        n = rows.shape[1]
        window = np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2
        f = np.fft.rfftfreq(n, 1.0 / residuals.groups[rung].rate)
        bin = np.searchsorted(grid, f, side="right") - 1
        good = (bin >= 0) & (bin < POINTS)
        for row in rows:
            lines = 2.0 * np.abs(np.fft.rfft((row - row.mean()) * window)) / window.sum()
            peak = np.zeros(POINTS)
            np.maximum.at(peak, bin[good], lines[good] ** 2)
            power += peak
            count += peak > 0
    seen = count > 0
    middle = 0.5 * (grid[1:] + grid[:-1])
    return middle[seen], np.sqrt(power[seen] / count[seen])
