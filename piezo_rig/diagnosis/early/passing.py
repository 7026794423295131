"""What passes is no loss: a recording that lost samples stays ahead of the others.

Two recordings of a drive that lose as many, one soon after the other, are level again. That is
what a knock on the table does, or anything else that comes and goes.
"""

from __future__ import annotations

from collections.abc import Sequence

from piezo_rig.diagnosis.early.mended import DROP, Break
from piezo_rig.diagnosis.groups import Groups

SOON_S = 0.2


def lasting(groups: Groups, breaks: Sequence[Break]) -> list[Break]:
    """Breaks without losses of two recordings that make up for each other before long."""
    passing = set[int]()
    of_two = [b for b in breaks if b.cause == DROP and groups.groups[b.group].repeats == 2]
    for g, end in sorted({(b.group, b.end) for b in of_two}):
        since: list[Break] = []
        for b in sorted(of_two, key=lambda b: b.index):
            if (b.group, b.end) != (g, end):
                continue
            since.append(b)
            if sum(b.count if b.row else -b.count for b in since) == 0:
                if since[-1].index - since[0].index < SOON_S * groups.rate:
                    passing |= {id(b) for b in since}
                since = []
    return [b for b in breaks if id(b) not in passing]
