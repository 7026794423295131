"""How visible an effect is to somebody who knows its form, the noise and the base's family.

d' = |P delta|: delta is what the effect changes over all recordings, P whitens it by the true
covariance of the noise and projects it off the base (50 play operators, the drive and its powers
2..5, and an offset for every recording).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.scoring import kernels
from piezo_rig.scoring.noise import Noise

FloatArray = NDArray[np.float64]
OPERATORS, POWERS = 50, 5
SMALLEST = 1e-13  # eigenvalue of the scaled Gram that still counts


def base_columns(drive_v: FloatArray, span_v: float) -> FloatArray:
    """Play operators up to the span and powers of the drive, shape (n, 55)."""
    drive = np.ascontiguousarray(drive_v)
    thresholds = span_v * (np.arange(OPERATORS) + 0.5) / OPERATORS
    plays = kernels.play(drive, thresholds)
    return np.hstack([plays, (drive[:, None] / span_v) ** np.arange(1, POWERS + 1)])


@dataclass(frozen=True, eq=False)
class Oracle:
    """The whitened base of a list of conditions, each played ``repeats`` times."""

    noise: Noise
    repeats: int
    span_v: float
    columns: tuple[FloatArray, ...]  # whitened, off the whitened offset, scaled
    offsets: tuple[FloatArray, ...]  # whitened, of unit length
    scale: FloatArray
    inverse_root: FloatArray  # of the Gram over all recordings

    @classmethod
    def of(cls, drives_v: Sequence[FloatArray], noise: Noise, repeats: int) -> Oracle:
        """``drives_v`` : one (n,) per condition"""
        span = max(float(np.max(np.abs(drive))) for drive in drives_v)
        columns, offsets = [], []
        for drive in drives_v:
            both = noise.whitened(
                np.column_stack([np.ones(drive.size), base_columns(drive, span)])
            )
            one = both[:, 0] / np.linalg.norm(both[:, 0])
            columns.append(both[:, 1:] - np.outer(one, one @ both[:, 1:]))
            offsets.append(one)
        gram = repeats * sum(a.T @ a for a in columns)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
        values, vectors = np.linalg.eigh(gram * np.outer(scale, scale))
        kept = values > SMALLEST * values[-1]
        root = vectors[:, kept] / np.sqrt(values[kept])
        return cls(noise, repeats, span, tuple(columns), tuple(offsets), scale, root)

    def _projected(self, rows: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Gram (m, m) off the offsets of m quantities, and coefficients (k, m) on the base.

        ``rows`` : (n, m), one per recording, all conditions of the first repeat first; or those
        of one repeat, which then stand for all
        """
        total: FloatArray = np.zeros((1, 1))
        onto: FloatArray = np.zeros((self.scale.size, 1))
        for k, row in enumerate(rows):
            a, one = self.columns[k % len(self.columns)], self.offsets[k % len(self.columns)]
            white = self.noise.whitened(row)
            white = white - np.outer(one, one @ white)
            total = total + white.T @ white
            onto = onto + a.T @ white
        copies = self.repeats * len(self.columns) / len(rows)
        return copies * total, copies * (self.inverse_root.T @ (self.scale[:, None] * onto))

    def gram(self, rows: Sequence[FloatArray]) -> FloatArray:
        """Inner products (m, m) of m changes, whitened and off the base.

        ``rows`` : (n, m) um, one per recording, or per condition if repeats agree
        """
        total, on = self._projected(rows)
        return total - on.T @ on

    def d_prime(self, delta: Sequence[FloatArray]) -> float:
        """Of a change ``delta``, um: one (n,) per recording, or per condition if repeats agree."""
        return float(np.sqrt(max(self.gram([row[:, None] for row in delta])[0, 0], 0.0)))

    def fitted(self, rows: Sequence[FloatArray]) -> FloatArray:
        """Coefficients of `base_columns` that fit recordings (n,) in um best, shape (55,)."""
        _, on = self._projected([row[:, None] for row in rows])
        return self.scale * (self.inverse_root @ on[:, 0])


def size_for(
    wanted: float, d_prime: Callable[[float], float], start: float, most: float
) -> tuple[float, float]:
    """The size whose d' is as wanted (within 1 %), and that d'; no larger than ``most``."""
    size = start
    low, high = 0.0, most
    here = 0.0
    for step in range(20):
        here = d_prime(size)
        if abs(here - wanted) < 0.01 * wanted:
            break
        if here < wanted:
            if size >= most:
                break
            low = max(low, size)
        else:
            high = min(high, size)
        guess = size * wanted / here if here > 0 else 10.0 * size
        if step > 6 or not low < guess < high:
            guess = most if guess >= high == most else 0.5 * (low + high)
        size = guess
    return size, here
