"""Where recordings stand on their own scale, while a model plays the drive along them.

A recording counts from its first sample. One that begins with a memory does not begin where a
model of it does, by as much as nobody knows of what was before; over the time that its memory is
known, the model and the recording agree but for one constant. So places are told by the mean over
that time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain.stage import Reads, Signal

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Placed:
    """The recordings along a signal, one behind the other.

    Attributes
    ----------
    begins : shape (m,), first sample of each
    weights : shape (n,), of every sample in the mean of its recording
    scale_um : shape (m,), see `Reads`; NaN where nothing is known
    """

    begins: NDArray[np.int64]
    weights: FloatArray
    scale_um: FloatArray

    @classmethod
    def of(cls, signal: Signal) -> Placed | None:
        """None where all stretches begin where the model does."""
        if signal.reads is None or all(r is None for r in signal.reads):
            return None
        made: Placed = signal.of_drive.get("placed", lambda: cls._of(signal))
        return made

    @classmethod
    def _of(cls, signal: Signal) -> Placed:
        time, ends = signal.time_s, np.append(signal.begins[1:], signal.time_s.size)
        begins, known, weights = list[int](), list[Reads | None](), np.zeros(time.size)
        assert signal.reads is not None
        for a, b, reads in zip(signal.begins.tolist(), ends.tolist(), signal.reads, strict=True):
            for k, own in enumerate(reads or (None,)):
                begins.append(a if k == 0 else a + _at(time[a:b], own.from_s if own else 0.0))
                known.append(own)
                if own is not None:
                    i, j = a + _at(time[a:b], own.from_s), a + _at(time[a:b], own.to_s)
                    weights[i:j] = _over_time(time[i:j])
        scale = [np.nan if own is None else own.scale_um for own in known]
        return cls(np.array(begins), weights, np.array(scale))

    def means(self, x: FloatArray) -> FloatArray:
        """Of values (n,) over the time that each memory is known, shape (m,)."""
        return np.asarray(np.add.reduceat(x * self.weights, self.begins))

    def spread(self, each: FloatArray) -> FloatArray:
        """Numbers (m,) of recordings for each of their samples, shape (n,)."""
        return np.repeat(each, np.diff(self.begins, append=self.weights.size))


def _at(time: FloatArray, seconds: float) -> int:
    """First sample that is not before an instant."""
    return int(np.searchsorted(time, seconds - 1e-9))


def _over_time(time: FloatArray) -> FloatArray:
    """Shares (n,) of samples in a mean over time."""
    steps = np.diff(time)
    if not steps.size:
        return np.ones(time.size)
    out = np.zeros(time.size)
    out[:-1] += 0.5 * steps
    out[1:] += 0.5 * steps
    return out / steps.sum()
