"""Half loops as the thesis looks at them: shifted to the origin, averaged, cut into segments.

Written apart from ``identification``, whose slope scheme it is laid beside.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import half_loops
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]

POINTS = 1001
SAME_V = 0.02  # ranges that differ by less are one condition
FEWEST = 6  # half loops that make a condition: three cycles


@dataclass(frozen=True, eq=False)
class MeanHalfLoop:
    """One half loop, averaged over cycles and repeats, begun at the origin.

    Attributes
    ----------
    start_v : drive at its turning point, the local extremum
    range_v : drive change, also that of the half loop before
    direction : +1 ascending, -1 descending
    drive_v, travel_um : shape (POINTS,), absolute changes since the turning point
    """

    start_v: float
    range_v: float
    direction: int
    drive_v: FloatArray
    travel_um: FloatArray


def mean_half_loops(sweeps: Iterable[Sweep]) -> list[MeanHalfLoop]:
    """The ascending and the descending half loop of every condition, in the order played.

    The first and the last cycle of a condition are left out, as in the thesis.
    """
    travels: dict[tuple[float, float, int], list[FloatArray]] = {}
    for sweep in sweeps:
        drive, displacement = sweep.drive_v, sweep.displacement_um
        loops = half_loops(drive)
        span = np.abs(drive[loops.stop] - drive[loops.start])
        for group in _runs(span):
            for i in group[2:-2] if len(group) >= FEWEST else ():
                a, b = int(loops.start[i]), int(loops.stop[i])
                v = np.abs(drive[a : b + 1] - drive[a])
                x = np.abs(displacement[a : b + 1] - displacement[a])
                key = (round(float(drive[a]), 1), round(float(v[-1]), 1), int(loops.direction[i]))
                at = np.linspace(0.0, key[1], POINTS)
                travels.setdefault(key, []).append(np.interp(at, v, x))
    return [
        MeanHalfLoop(start, span, way, np.linspace(0.0, span, POINTS), np.mean(curves, axis=0))
        for (start, span, way), curves in travels.items()
    ]


def _runs(span: FloatArray) -> list[list[int]]:
    """Indices of half loops in a row that have one range."""
    cuts = np.flatnonzero(np.abs(np.diff(span)) > SAME_V) + 1
    return [list(map(int, run)) for run in np.split(np.arange(span.size), cuts)]


def first_rise(sweeps: Iterable[Sweep]) -> tuple[FloatArray, FloatArray]:
    """Drive and displacement of the first rises of virgin sweeps of one condition, averaged."""
    drives, travels = [], []
    for sweep in sweeps:
        loops = half_loops(sweep.drive_v)
        end = int(loops.stop[0]) + 1
        drives.append(sweep.drive_v[:end] - sweep.drive_v[0])
        travels.append(sweep.displacement_um[:end] - sweep.displacement_um[0])
    return np.mean(drives, axis=0), np.mean(travels, axis=0)


def pick(
    loops: Sequence[MeanHalfLoop], start_v: float, range_v: float, direction: int
) -> MeanHalfLoop:
    """The half loop that begins at ``start_v`` and spans ``range_v``."""
    for loop in loops:
        near = abs(loop.start_v - start_v) < 0.5 and abs(loop.range_v - range_v) < 0.5
        if near and loop.direction == direction:
            return loop
    raise KeyError(f"no half loop from {start_v:g} V over {range_v:g} V, direction {direction:+d}")


def segment_slopes(drive_v: FloatArray, travel_um: FloatArray, step_um: float) -> FloatArray:
    """Slope of the drive over the displacement in every segment of ``step_um``, V/um.

    The last segment counts even when the half loop crosses only a part of it: this is what
    Appendix F does, and what the outlier of Figure 2-6(f) comes from.

    Parameters
    ----------
    drive_v, travel_um : shape (n,), both from 0 on

    Returns
    -------
    shape (number of segments begun,)
    """
    segment = (travel_um / step_um).astype(int)
    segment = np.minimum(segment, max(0, int(np.ceil(travel_um[-1] / step_um)) - 1))
    slopes = []
    for i in range(int(segment.max()) + 1):
        inside = segment == i
        if np.count_nonzero(inside) < 2:
            break
        x = travel_um[inside] - travel_um[inside].mean()
        slopes.append(float(x @ drive_v[inside] / (x @ x)))
    return np.array(slopes)


def springs(slopes: FloatArray) -> FloatArray:
    """Spring constants from slopes, eq. 12 solved: k_i = s_i - s_(i+1), the last is its slope."""
    return -np.diff(slopes, append=0.0)
