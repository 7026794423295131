"""How long recordings are shortened: averaged over cells, single samples kept beside corners.

Away from corners of the drive an actuator moves smoothly, and averages over a few milliseconds
lose nothing. Within some milliseconds of a corner a delay, a lag, a mode that rings and a loop
that opens with speed look different from each other, and only there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Ranges = tuple[tuple[int, int], ...]
BEFORE_S, AFTER_S = 0.004, 0.024  # of a corner: the longest plausible delay; a mode rings so long
MOST_BEFORE, MOST_AFTER = 100, 500  # samples, of recordings that are finer than they need be
LONGEST = 1000  # samples of a stretch: their covariance is made whole
BENT = 0.5  # change of step at a corner, of the step itself
MOVING = 0.05  # and of the largest steps of the recording


@dataclass(frozen=True)
class Cells:
    """One stretch of samples in cells of ``factor``, of which some are split into samples.

    ``marks`` : one byte per cell of ``factor`` samples, 1 where it is split
    """

    factor: int
    marks: bytes

    @cached_property
    def split(self) -> NDArray[np.bool_]:
        """Which cells are split, shape (n,)."""
        return np.frombuffer(self.marks, bool)

    @cached_property
    def begins(self) -> NDArray[np.int64]:
        """Where each cell begins in the shortened stretch, and where the last ends; (n + 1,)."""
        return np.concatenate([[0], np.cumsum(np.where(self.split, self.factor, 1))])

    @property
    def size(self) -> int:
        """Length m of the shortened stretch."""
        return int(self.begins[-1])

    @cached_property
    def share(self) -> FloatArray:
        """How much of a whole cell each value stands for, shape (m,)."""
        return np.repeat(np.where(self.split, 1.0 / self.factor, 1.0), np.diff(self.begins))

    def part(self, begin: int, end: int) -> Cells:
        """Some of the cells."""
        return Cells(self.factor, self.marks[begin:end])

    def shortened(self, values: FloatArray) -> FloatArray:
        """Values (..., samples) as averages of cells and single samples, shape (..., m)."""
        n, lead = len(self.marks), values.shape[:-1]
        cut = values[..., : n * self.factor]
        if self.factor == 1:
            return cut
        cut = cut.reshape(*lead, n, self.factor)
        even = np.full(self.factor, 1.0 / self.factor)
        # averaged by a product, which is far faster than a mean over few
        mean = np.asarray(cut @ even)
        if not self.split.any():
            return mean
        out = np.empty((*lead, self.size))
        out[..., self.whole] = mean[..., ~self.split]
        out[..., self.single] = cut[..., self.split, :].reshape(*lead, -1)
        return out

    def averages(self, values: FloatArray) -> FloatArray:
        """Averages of all cells, shape (..., n), from shortened values (..., m)."""
        if not self.split.any() or self.factor == 1:
            return values
        out = np.empty((*values.shape[:-1], len(self.marks)))
        out[..., ~self.split] = values[..., self.whole]
        even = np.full(self.factor, 1.0 / self.factor)
        single = values[..., self.single].reshape(*values.shape[:-1], -1, self.factor)
        out[..., self.split] = single @ even
        return out

    @cached_property
    def single(self) -> NDArray[np.int64]:
        """Where single samples are in the shortened stretch."""
        return np.flatnonzero(np.repeat(self.split, np.diff(self.begins)))

    @cached_property
    def whole(self) -> NDArray[np.int64]:
        """Where the averages of cells that are not split are in the shortened stretch."""
        return self.begins[:-1][~self.split]

    @cached_property
    def runs(self) -> list[tuple[int, int]]:
        """Neighbouring cells that are split: (first, one past last)."""
        edges = np.flatnonzero(np.diff(np.concatenate([[0], self.split.astype(int), [0]])))
        return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]

    def centred(self, rows: FloatArray) -> FloatArray:
        """Shortened rows (k, m) less their means, so scaled that every sample weighs the same."""
        if self.factor == 1 or not self.split.any():
            return np.asarray(rows - rows.mean(axis=-1, keepdims=True))
        mean = rows @ self.share / self.share.sum()
        return np.asarray((rows - mean[..., None]) * np.sqrt(self.share))


@lru_cache(maxsize=512)
def cells_of(begin: int, end: int, fine: Ranges, factor: int) -> Cells:
    """Cells of samples begin..end; those that ``fine`` ranges of samples touch are split."""
    count = (end - begin) // factor
    split = np.zeros(count, bool)
    if factor > 1:
        for a, b in fine:
            split[max((a - begin) // factor, 0) : max(-((begin - b) // factor), 0)] = True
    return Cells(factor, split.tobytes())


def corners(drive_v: FloatArray, blocks: Sequence[tuple[int, int]], factor: int) -> list[int]:
    """Samples at which a drive bends; where a recording begins to move at once, its first too."""
    found: list[int] = []
    steps = [
        np.diff(cells_of(a, b, (), factor).shortened(drive_v[a:b])) for a, b in blocks
    ]
    every = np.abs(np.concatenate(steps)) if steps else np.zeros(0)
    least = MOVING * float(np.percentile(every, 90)) if every.size else 0.0
    for (a, _), step in zip(blocks, steps, strict=True):
        step = np.concatenate([[0.0], step])
        bend = np.abs(np.diff(step))
        around = np.maximum(np.abs(step[1:]), np.abs(step[:-1]))
        bent = np.flatnonzero(bend > np.maximum(BENT * around, least))
        found += [a + factor * int(k) + factor // 2 for k in bent]
    return found


def beside_corners(
    at: Sequence[int], rate: float, most: int, samples: int, kept: int = 1 << 20
) -> Ranges:
    """Ranges of samples around corners, joined where they meet; at most so many corners.

    Of too many, those that are kept lie evenly along the recording.

    Parameters
    ----------
    samples : of the recording
    kept : samples that may be in ranges, but for those of one corner
    """
    before = min(round(BEFORE_S * rate), MOST_BEFORE)
    after = min(round(AFTER_S * rate), MOST_AFTER)
    most = max(min(most, kept // (before + after)), 1)
    apart: list[int] = []
    for k in at:
        if not apart or k - apart[-1] > before:
            apart.append(k)
    if len(apart) > most:
        apart = [apart[round(k)] for k in np.linspace(0, len(apart) - 1, most)]
    out: list[tuple[int, int]] = []
    for k in apart:
        begin, end = max(k - before, 0), min(k + after, samples)
        if out and begin <= out[-1][1]:
            if end - out[-1][0] > LONGEST:
                continue
            begin, _ = out.pop()
        out.append((begin, end))
    return tuple(out)
