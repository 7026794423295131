"""Noise made white where recordings are averages of cells, and single samples beside corners.

The averages are one evenly sampled series and are filtered as such (`noise.Whitener`). What the
single samples say beside their cell's average is taken given the averages around: its mean and
covariance then follow from the noise's covariance alone (a regression among Gaussians). So both
together are white, but for what averages further off say, which is next to nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.linalg import cholesky, solve_triangular

from piezo_rig.diagnosis.cells import Cells
from piezo_rig.diagnosis.noise import RAISED, Spectrum, Whitener

FloatArray = NDArray[np.float64]
MARGIN = 8  # cells on either side whose averages are allowed for
LONG = 1 << 15  # samples over which the spectrum is taken, at least
Turn = tuple[FloatArray, FloatArray]
Indices = NDArray[np.int64]


class CellWhitener:
    """Rows of shortened stretches made white with variance 1.

    Parameters
    ----------
    averages : spectrum of one recording at the rate of the cells
    samples : spectrum at full rate; None where no cell is split
    raised : standard errors by which both are raised
    """

    def __init__(
        self, averages: Spectrum, samples: Spectrum | None = None, raised: float = RAISED
    ) -> None:
        self.averages = Whitener(averages, raised)
        self.samples = Whitener(samples, raised) if samples is not None else None
        self._turns: dict[tuple[int, int, int, int], Turn] = {}
        self._ones: dict[Cells, FloatArray] = {}
        self._alike: dict[Cells, list[tuple[Turn, Indices, Indices, Indices]]] = {}

    @property
    def spectrum(self) -> Spectrum:
        """That of the averages."""
        return self.averages.spectrum

    def __call__(self, rows: FloatArray, cells: Cells) -> FloatArray:
        """Filtered rows (k, m): all averages first, then what single samples say beside them."""
        mean = cells.averages(rows)
        white = self.averages(mean)
        if mean is rows:
            return white
        out, at = np.empty(rows.shape), mean.shape[1]
        out[:, :at] = white
        for (own, given), single, around, to in self._turns_of(cells):
            count = rows.shape[0], len(single)
            beside = rows[:, single].reshape(-1, single.shape[1]) @ own.T
            beside += mean[:, around].reshape(-1, around.shape[1]) @ given.T
            out[:, to.ravel()] = beside.reshape(count[0], -1)
        return out[:, : at + sum(to.size for *_, to in self._turns_of(cells))]

    def ones(self, cells: Cells) -> FloatArray:
        """A constant of 1, filtered; not to be written to."""
        if cells not in self._ones:
            self._ones[cells] = self(np.ones((1, cells.size)), cells)[0]
        return self._ones[cells]

    def beside_offset(self, rows: FloatArray, cells: Cells) -> FloatArray:
        """Filtered rows, their offsets projected out."""
        white, one = self(rows, cells), self.ones(cells)
        white -= np.outer(white @ one / float(one @ one), one)
        return white

    def _turns_of(self, cells: Cells) -> list[tuple[Turn, Indices, Indices, Indices]]:
        """Of all corners that are alike, (r, n) each: single samples, averages around, where what
        is taken of them is put.
        """
        if cells not in self._alike:
            made: list[tuple[Turn, Indices, Indices, Indices]] = []
            count = last = len(cells.marks)
            found: dict[tuple[int, int, int], list[tuple[range, range, range]]] = {}
            for i, j in cells.runs:
                begin, end = max(i - MARGIN, 0), min(j + MARGIN, count)
                size = (j - i) * (cells.factor - 1)
                found.setdefault((i - begin, j - i, end - j), []).append((
                    range(cells.begins[i], cells.begins[j]), range(begin, end),
                    range(last, last + size),
                ))  # fmt: skip
                last += size
            for key, own in found.items():
                single, around, to = (np.array(x, np.int64) for x in zip(*own, strict=True))
                made.append((self._turn(*key, cells.factor), single, around, to))
            self._alike[cells] = made
        return self._alike[cells]

    def _turn(self, before: int, split: int, after: int, factor: int) -> Turn:
        """What is taken of single samples and of averages; shapes (d, samples), (d, averages)."""
        key = before, split, after, factor
        if key not in self._turns:
            self._turns[key] = self._made(*key)
        return self._turns[key]

    def _made(self, before: int, split: int, after: int, f: int) -> Turn:
        assert self.samples is not None
        count = before + split + after
        lag = np.abs(np.subtract.outer(np.arange(count * f), np.arange(count * f)))
        covariance = self._autocovariance(count * f)[lag]
        average = np.kron(np.eye(count), np.full((1, f), 1.0 / f))
        # what samples of one cell say beside their average: f - 1 directions
        aside = np.linalg.qr(np.column_stack([np.ones(f), np.eye(f)[:, 1:]]))[0][:, 1:].T
        own = np.kron(np.eye(split), aside)
        inside = slice(before * f, (before + split) * f)
        of_averages = average @ covariance @ average.T
        cross = own @ covariance[inside] @ average.T
        of_averages += 1e-12 * np.trace(of_averages) / count * np.eye(count)
        given = np.linalg.solve(of_averages, cross.T).T
        rest = own @ covariance[inside, inside] @ own.T - given @ cross.T
        lower = cholesky(0.5 * (rest + rest.T), lower=True)
        return (solve_triangular(lower, own, lower=True),
                solve_triangular(lower, -given, lower=True))  # fmt: skip

    def _autocovariance(self, count: int) -> FloatArray:
        assert self.samples is not None
        size = max(LONG, 8 * count)
        grid = np.arange(size // 2 + 1) / size
        power = self.samples.spectrum.power(grid, self.samples.raised)
        return np.asarray(fft.irfft(power, size)[:count])
