"""Which part of what was left out goes no further than what was not.

A random walk goes further in its last third, as often as not, than in all that came before. Where
it does, the element tables go where they like, with the right cause as with a wrong one, and what
the memory then keeps of it is one more free offset.
"""

from __future__ import annotations

import numpy as np

from piezo_rig.chain.reach import reaches_of, within
from piezo_rig.diagnosis.groups import Group

SLACK = 0.01  # of how far what was seen goes
LEAST, SHORT = 0.1, 8  # of what was left out, and samples: less is not worth scoring


def covered(group: Group, begin: int) -> list[tuple[int, int]]:
    """Stretches (first, one past last) of a group from a sample on, where its half loops go no
    further along the first rise and along branches than those before; all of it if hardly any do.
    """
    n, start = group.drive_v.size, group.loops.start
    seen = within(group.loops, group.blocks) & (start < begin)
    inside = np.ones(start.size, bool)
    for reach in reaches_of(group.drive_v, group.loops):
        inside &= reach <= (1.0 + SLACK) * np.max(reach[seen], initial=0.0)
    edges = np.append(start, n)
    out: list[tuple[int, int]] = []
    for k in np.flatnonzero(inside):
        a, b = max(int(edges[k]), begin), int(edges[k + 1])
        if b <= a:
            continue
        if out and out[-1][1] == a:
            out[-1] = (out[-1][0], b)
        else:  # it begins where an excursion ends: that sample is the furthest of all
            out.append((a + (a > begin), b))
    kept = [(a, b) for a, b in out if b - a >= SHORT]
    if sum(b - a for a, b in kept) < LEAST * (n - begin):
        return [(begin, n)]
    return kept


def grows(group: Group, begin: int) -> bool:
    """Whether from a sample on a drive goes further than before, and does hardly anything else."""
    known = within(group.loops, group.blocks)
    later = known & (group.loops.start >= begin)
    limit = 1.0 + SLACK
    further = [
        np.max(reach[later], initial=0.0) > limit * np.max(reach[known & ~later], initial=0.0)
        for reach in reaches_of(group.drive_v, group.loops)
    ]
    return any(further) and covered(group, begin) == [(begin, group.drive_v.size)]


def first_rise_within(group: Group, end: int) -> bool:
    """Whether a drive from rest goes on where it has been before, from a sample on."""
    away = np.abs(group.drive_v - group.drive_v[0])
    return group.virgin and bool(np.max(away[end:], initial=0.0) <= np.max(away[:end], initial=0.0))
