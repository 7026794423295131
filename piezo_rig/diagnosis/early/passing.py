"""What passes is no loss: a recording that lost samples stays ahead of the others.

Two recordings of a drive that lose as many, one soon after the other, are level again. That is
what a knock on the table does, or anything else that comes and goes.
"""

from __future__ import annotations

from collections.abc import Sequence

from piezo_rig.diagnosis.early.mended import DROP, Break
from piezo_rig.diagnosis.groups import Groups

AT_ONCE_S, SOON_S = 0.06, 0.2  # within which they are level again; the same if it happens twice


def lasting(groups: Groups, breaks: Sequence[Break]) -> list[Break]:
    """Breaks without losses of two recordings that make up for each other before long."""
    passing = set[int]()
    of_two = [b for b in breaks if b.cause == DROP and groups.groups[b.group].repeats == 2]
    for g, end in sorted({(b.group, b.end) for b in of_two}):
        mine = sorted((b for b in of_two if (b.group, b.end) == (g, end)), key=lambda b: b.index)
        soon = _level_again(mine, SOON_S * groups.rate)
        for few in soon if len(soon) > 1 else _level_again(mine, AT_ONCE_S * groups.rate):
            passing |= {id(b) for b in few}
    return [b for b in breaks if id(b) not in passing]


def _level_again(losses: Sequence[Break], within: float) -> list[list[Break]]:
    """Those after which neither recording is ahead any more, soon after the first of them."""
    out, since = list[list[Break]](), list[Break]()
    for b in losses:
        since.append(b)
        if sum(x.count if x.row else -x.count for x in since) == 0:
            if b.index - since[0].index < within:
                out.append(since)
            since = []
    return out
