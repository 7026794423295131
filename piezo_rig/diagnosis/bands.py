"""What all repeats of a drive share in a band of frequencies, though no model has it.

A mode that rings, or moves, is fast: in averages of cells little of it is left, and no function of
drive, displacement and time since a turn looks like it. Noise is in every repeat another one: what
they share beyond that is of the drive.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from piezo_rig.chain import Model
from piezo_rig.diagnosis.chances import fisher_above
from piezo_rig.diagnosis.groups import Group, Groups

FloatArray = NDArray[np.float64]
LOWEST_CELLS = 20.0  # of the shortest recording, where bands begin: below is what elements are for
OCTAVE = 2.0  # bands to one
NYQUIST = 0.45  # of the rate
ALIKE = 1.94  # Hann-windowed bins that count as one: neighbours have 4/9 in common, the next 1/36


@dataclass(frozen=True)
class Band:
    """From ``low_hz`` to ``high_hz`` repeats share ``rms_nm`` more than noise would have them."""

    p_value: float
    low_hz: float
    high_hz: float
    rms_nm: float


def shared_band(groups: Groups, model: Model) -> Band | None:
    """The band in which what all repeats of a drive share is the least likely noise.

    In half octaves the mean of repeats, less what a model predicts, is held against what they
    differ by (Fisher's law); the chance is that of as many bands as there are. None without
    repeats, or without recordings that are long enough.
    """
    known = [(g, a, b) for g in groups.groups if g.repeats > 1 for a, b in g.blocks]
    shortest = min((b - a for _, a, b in known), default=0)
    lowest = LOWEST_CELLS * groups.rate / max(shortest, 1)
    count = int(OCTAVE * np.log2(max(NYQUIST * groups.rate / lowest, 1.0)))
    if count < 1:
        return None
    edges = lowest * 2.0 ** (np.arange(count + 1) / OCTAVE)
    squares, freedom, power = np.zeros((2, count)), np.zeros((2, count)), np.zeros(count)
    for g, a, b in known:
        shared, apart, bins = _powers(g, a, b, model, edges, groups.rate)
        squares += g.repeats * shared, apart
        freedom += 2.0 * bins / ALIKE * np.array([[1.0], [g.repeats - 1.0]])
        power += shared * (b - a)
    seen = np.maximum(freedom, 1e-300)
    ratio = squares[0] / seen[0] / np.maximum(squares[1] / seen[1], 1e-300)
    chances = np.array([fisher_above(*r) for r in zip(ratio, *freedom, strict=True)])
    best = int(np.argmin(np.log(np.maximum(chances, 1e-300)) - 1e-6 * ratio))
    samples = sum(b - a for _, a, b in known)
    real = max(1.0 - 1.0 / max(float(ratio[best]), 1e-300), 0.0)  # not what noise alone would make
    beyond = float(power[best]) * real / samples
    return Band(
        min(1.0, count * float(chances[best])), float(edges[best]), float(edges[best + 1]),
        1e3 * float(np.sqrt(beyond)),
    )  # fmt: skip


def _powers(
    g: Group, a: int, b: int, model: Model, edges: FloatArray, rate: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of every band (m,): the squared mean of the repeats and the sum of the squares that they are
    off it, um^2, and how many bins it has.
    """
    left = g.at_one_time(model).measured_um[:, a:b] - g.predicted(model)[a:b]
    along = np.linspace(-1.0, 1.0, b - a)
    left = left - left.mean(axis=1, keepdims=True)
    left = left - np.outer(left @ along / (along @ along), along)
    window = np.sin(np.pi * (np.arange(b - a) + 0.5) / (b - a)) ** 2
    lines = fft.rfft(left * window / np.sqrt(np.mean(window**2))) / (b - a)
    mean = lines.mean(axis=0)
    apart = np.sum(np.abs(lines - mean) ** 2, axis=0)
    at = np.searchsorted(edges, np.arange(mean.size) * rate / (b - a), side="right") - 1
    inside = (at >= 0) & (at < edges.size - 1)

    def by_band(w: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(at[inside], w[inside], minlength=edges.size - 1), float)

    return by_band(2.0 * np.abs(mean) ** 2), by_band(2.0 * apart), by_band(np.ones(mean.size))
