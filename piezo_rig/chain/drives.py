"""Drives as a model plays them: checked, with what comes before them, and several at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain.half_loops import half_loops
from piezo_rig.chain.stage import Reads, Signal
from piezo_rig.errors import InputError

FloatArray = NDArray[np.float64]
LONG_AGO_S = 1e7


@dataclass(frozen=True, eq=False)
class Drives:
    """Several drives, to be played at once as one signal, each by itself.

    Attributes
    ----------
    signal : all of them before any stage, with what comes before those that are no virgins
    inside : which samples of it are given
    begins : shape (k,), where each begins among those
    """

    signal: Signal
    inside: NDArray[np.bool_] | slice
    begins: NDArray[np.int64]

    @classmethod
    def of(
        cls, plays: Sequence[tuple[FloatArray, FloatArray, str]],
        reads: Sequence[tuple[Reads, ...] | None] | None = None,
        played: Sequence[FloatArray] | None = None,
    ) -> Drives:  # fmt: skip
        """From times (n,), drives (n,), histories, readings and cycles, as `Model.simulate` does.

        Raises
        ------
        InputError : a gap in a drive
        """
        each = [begun(*play) for play in plays]
        for signal, _ in each:
            if not np.all(np.isfinite(signal.drive_v)):
                refuse_gaps(signal.drive_v)
        sizes = np.array([s.drive_v.size for s, _ in each])
        before = np.array([count for _, count in each])
        ends = np.cumsum(sizes)
        signal = Signal(
            np.concatenate([s.time_s for s, _ in each]),
            np.concatenate([s.drive_v for s, _ in each]), np.zeros(0), ends - sizes,
            reads=None if reads is None else tuple(reads),
            played=None if played is None else tuple(played),
        )  # fmt: skip
        inside: NDArray[np.bool_] | slice = slice(None)
        if before.any():
            at = np.arange(ends[-1]) - np.repeat(ends - sizes, sizes)
            inside = at >= np.repeat(before, sizes)
        given = np.cumsum(sizes - before)
        return cls(signal, inside, given - (sizes - before))


def since_begun(x: FloatArray, begins: NDArray[np.int64]) -> FloatArray:
    """Values (n,) of stretches less the first of each."""
    return x - np.repeat(x[begins], np.diff(begins, append=x.size))


def first_measured(time_s: FloatArray) -> int:
    """First sample behind whatever `Model.simulate` has put long before a drive."""
    before = np.flatnonzero(np.diff(time_s) > 0.5 * LONG_AGO_S)
    return int(before[-1]) + 1 if before.size else 0


def begun(
    time_s: FloatArray, drive_v: FloatArray, history: str, reads: tuple[Reads, ...] | None = None,
    played: FloatArray | None = None,
) -> tuple[Signal, int]:  # fmt: skip
    """The signal before any stage, and how many samples come before the given drive."""
    time, drive = _checked(time_s, drive_v)
    if history == "virgin":
        return at_rest(time, drive, reads, played), 0
    if not np.all(np.isfinite(drive)):
        refuse_gaps(drive)
    whole = preceded(drive)
    before = whole.size - drive.size
    return at_rest(long_after(time, before), whole, reads, played), before


def at_rest(
    time_s: FloatArray, drive_v: FloatArray, reads: tuple[Reads, ...] | None = None,
    played: FloatArray | None = None,
) -> Signal:  # fmt: skip
    before = None if played is None else (played,)
    known = None if reads is None else (reads,)
    return Signal(time_s, drive_v, np.zeros(0), reads=known, played=before)


def long_after(time_s: FloatArray, before: int) -> FloatArray:
    """Times (n,) with those of so many samples long before them."""
    return np.concatenate([time_s[0] - LONG_AGO_S * np.arange(before, 0, -1), time_s])


def preceded(drive: FloatArray) -> FloatArray:
    """The drive with its own turning points played before it, from the smaller extreme."""
    loops = half_loops(drive)
    turns = drive[np.append(loops.start, drive.size - 1)]
    low, high = float(np.min(turns)), float(np.max(turns))
    ends = [0.0, low, high, low] if low >= 0 else [0.0, high, low, high]
    return np.concatenate([ends, [drive[0]], drive])


def _checked(time_s: FloatArray, drive_v: FloatArray) -> tuple[FloatArray, FloatArray]:
    time = np.ascontiguousarray(time_s, dtype=float)
    drive = np.ascontiguousarray(drive_v, dtype=float)
    if time.ndim != 1 or time.shape != drive.shape:
        raise InputError(
            "unequal-lengths",
            f"time has shape {time.shape}, drive {drive.shape}",
            "a column is cut short",
            "give one drive value for every time",
        )
    return time, drive


def refuse_gaps(drive: FloatArray) -> None:
    bad = np.flatnonzero(~np.isfinite(drive))
    raise InputError(
        "not-a-number",
        f"the drive is not a number at sample {bad[0] if bad.size else 0} ({bad.size} in all)",
        "a gap in the recording",
        "cut the gap out, or interpolate it",
    )
