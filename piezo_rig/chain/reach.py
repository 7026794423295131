"""How far along its curves a drive takes an actuator, by Madelung's rules.

A half loop that passes an older turning point forgets the loop that it closes there and goes on
along the older branch, so a branch may be followed for longer than any half loop lasts.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain.half_loops import HalfLoops

FloatArray = NDArray[np.float64]


def reaches(turns_v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Volts along the first rise and along later branches that every leg of a drive goes to.

    Parameters
    ----------
    turns_v : shape (n,), where a virgin actuator begins and where the drive then goes

    Returns
    -------
    first, later : shape (n - 1,), counted from the start and from the turning point of the
        branch; 0 where a leg does not touch that curve
    """
    first, later = np.zeros(turns_v.size - 1), np.zeros(turns_v.size - 1)
    start = at = float(turns_v[0])
    turned: list[float] = []  # turning points that are remembered; none: on the first rise
    before = 0.0
    for leg, to in enumerate(float(v) for v in turns_v[1:]):
        way = float(np.sign(to - at))
        if way == 0.0:
            continue
        if way == -before:
            turned.append(at)
        at, before = to, way
        while turned:
            end = turned[-2] if len(turned) > 1 else 2.0 * start - turned[-1]
            inside = (to - end) * way <= 0.0
            later[leg] = max(later[leg], abs((to if inside else end) - turned[-1]))
            if inside:
                break
            del turned[-2:]
        if not turned:
            first[leg] = abs(to - start)
    return first, later


def reaches_of(drive_v: FloatArray, loops: HalfLoops) -> tuple[FloatArray, FloatArray]:
    """`reaches` of the half loops of a drive (n,), each shape (m,), from a virgin start."""
    return reaches(drive_v[np.append(loops.start, drive_v.size - 1)])


def within(loops: HalfLoops, blocks: Sequence[tuple[int, int]]) -> NDArray[np.bool_]:
    """Which half loops begin in one of some blocks (first, one past last sample), shape (m,)."""
    return np.any([(loops.start >= a) & (loops.start < b) for a, b in blocks], axis=0)


def longest_branch(
    drive_v: FloatArray, loops: HalfLoops, blocks: Sequence[tuple[int, int]]
) -> float:
    """Largest drive change along one branch after a turning point in some blocks, volts."""
    _, later = reaches_of(drive_v, loops)
    return float(np.max(later[within(loops, blocks)], initial=0.0))
