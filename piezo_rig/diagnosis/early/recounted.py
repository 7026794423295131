"""Losses in recordings of drives that were recorded once, counted beside a base that is refitted
for every count.

Such a base is fitted to what comes before a loss and to what comes after it: it is late here and
early there, and shows a share of the loss only, or nothing that looks like one. Refitted to
recordings that are mended of the right number it leaves far less than of any other, so the number
is what leaves least.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from piezo_rig.diagnosis.early.mended import DROP, Break, lead, mended
from piezo_rig.diagnosis.early.traces import sweep_bounds
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.run_file.sweep import Sweep

# squared error, of that by the first count, that another must leave at most: beside a base, and
# beside a model that has what else there is
PLAINLY, BESIDE_ALL = 0.5, 0.9
TURNS = 3  # in which the losses are looked at one after the other
MOST = 400  # samples
AHEAD, ABOUT = 60, 3  # samples of a loss at which it is looked for first, and later
FIRST, MANY, NEARER = 0.9, 8, 6  # of what was left before, by a first guess; losses; turns
LEAST = 200  # samples to either side
BESIDE, SAME = 8, 1.01  # samples between two that may be one; of what they leave


def recounted(
    groups: Groups, point: Point, breaks: Sequence[Break],
    refitted: Callable[[Groups, Point], Point], enough: float = PLAINLY,
) -> list[Break]:  # fmt: skip
    """Breaks with the losses that a refitted base asks for, where that is plainly others.

    ``enough`` : squared error, of that by the first count, that another must leave at most
    """
    here = list(breaks)
    losses = [b for b in here if b.cause == DROP and groups.groups[b.group].repeats < 2]
    members = {b.group for b in losses}
    if not 0 < len(losses) <= MANY or any(b.sure for b in here):
        return here

    def left(tried: Sequence[Break]) -> float:
        kept = [b for b in tried if b.count]
        whole = mended(groups, [g.predicted(point.model) for g in groups.groups], kept)
        return square_of(whole, refitted(whole, point), members)

    begun = least = left(here)
    for _ in range(TURNS):
        before = least
        for k, loss in enumerate(here):
            if loss.cause == DROP and loss.group in members:
                here, least = _best(here, k, least, left)
        if least >= before:
            break
    if least >= enough * begun:
        return list(breaks)
    return _joined([b for b in here if b.count], least, left)


def outright(
    groups: Groups, point: Point, sweeps: Sequence[Sweep], known: Sequence[Break],
    refitted: Callable[[Groups, Point], Point], behind: float,
) -> list[Break]:  # fmt: skip
    """Losses one after the other, where they leave far less than other causes do; as they were
    known otherwise.

    A recording that is known to have lost samples needs less to have lost others as well.
    ``behind`` : squared error of those causes, um^2, over the groups without repeats
    """
    members = {k for k, g in enumerate(groups.groups) if g.repeats < 2}
    enough = BESIDE_ALL if any(b.cause == DROP for b in known) else PLAINLY
    found = list(known)
    if found:
        whole = mended(groups, [g.predicted(point.model) for g in groups.groups], found)
        point = refitted(whole, point)
        left = square_of(whole, point, members)
    else:
        left = square_of(groups, point, members)
    for _ in range(MANY):
        tried, there = _one_more(groups, point, found, sweeps, members, refitted)
        if tried is None or (worth := square_of(*there, members)) > enough * left:
            break
        found, left, point = tried, worth, there[1]
    if not left < enough * behind:
        return list(known)
    return recounted(groups, point, found, refitted, 1.0)  # each beside all others


def _one_more(
    groups: Groups, point: Point, known: list[Break], sweeps: Sequence[Sweep], members: set[int],
    refitted: Callable[[Groups, Point], Point],
) -> tuple[list[Break] | None, tuple[Groups, Point]]:  # fmt: skip
    """Losses with the plainest one that is not known; the recordings mended, the base refitted."""
    tried: list[Break] | None = None
    whole = mended(groups, [g.predicted(point.model) for g in groups.groups], known)
    for _ in range(NEARER):
        counts = range(1, AHEAD + 1)
        if tried is not None:
            counts = range(max(tried[-1].count - ABOUT, 1), tried[-1].count + ABOUT + 1)
        new = _plainest(whole, point, sweeps, members, counts)
        if new is None:
            return None, (whole, point)
        index = new.index - lead(known, new.group, 0, new.index)
        new = replace(new, index=index, low=index, high=index)
        same = tried is not None and (index, new.count) == (tried[-1].index, tried[-1].count)
        first, tried = tried is None, [*known, new]
        if first:  # the base is late before it and early after it
            tried = recounted(groups, point, tried, refitted)
        if not tried:
            return None, (whole, point)
        mine = mended(groups, [g.predicted(point.model) for g in groups.groups], tried)
        point = refitted(mine, point)
        if same:
            break
    assert tried is not None
    return tried, (mine, point)


def _plainest(
    groups: Groups, point: Point, sweeps: Sequence[Sweep], members: set[int], counts: range
) -> Break | None:
    """The loss, at any sample of any such recording, that takes off most as things are."""
    best, out = 0.0, None
    for k in members:
        group = groups.groups[k]
        predicted = group.predicted(point.model)
        for begin, end in sweep_bounds(group, 0, sweeps):
            seen, model = group.measured_um[0, begin:end], predicted[begin:end]
            n = seen.size
            offset = float(np.median(seen - model))
            plain = (seen - model - offset) ** 2
            for count in counts:
                if n - count <= 2 * LEAST or count > n // 4:
                    break
                ahead = (seen[: n - count] - model[count:] - offset) ** 2
                taken = np.cumsum((plain[: n - count] - ahead)[::-1])[::-1]  # from there on
                at = LEAST + int(np.argmax(taken[LEAST : n - count - LEAST]))
                if taken[at] > best:
                    best, index = float(taken[at]), begin + at
                    out = Break(DROP, k, 0, index, count, index, index, end, 0.0)
    return out if best > (1.0 - FIRST) * square_of(groups, point, members) else None


def _joined(
    breaks: list[Break], least: float, left: Callable[[Sequence[Break]], float]
) -> list[Break]:
    """Two losses as one at the place of either, where that leaves less; no more, if within some
    samples.
    """
    for a in breaks:
        for b in breaks:
            if a is b or (a.cause, a.group, a.row) != (DROP, b.group, b.row) or b.cause != DROP:
                continue
            one = replace(a, count=a.count + b.count, p_value=min(a.p_value, b.p_value))
            fewer = [one if x is a else x for x in breaks if x is not b]
            most = least * (SAME if abs(a.index - b.index) <= BESIDE else 1.0)
            if (worth := left(fewer)) < most:
                return _joined(fewer, worth, left)
    return breaks


def _best(
    breaks: Sequence[Break], k: int, least: float, left: Callable[[Sequence[Break]], float]
) -> tuple[list[Break], float]:
    """One loss at the count that leaves least, found by steps that double and then halve."""
    best, step = list(breaks), 1
    while step:
        for sign in (1, -1):
            count = best[k].count + sign * step
            if not 0 <= count <= MOST:
                continue
            tried = [replace(b, count=count) if j == k else b for j, b in enumerate(best)]
            if (worth := left(tried)) < least:
                best, least, step = tried, worth, 2 * step
                break
        else:
            step //= 2
    return best, least


def square_of(groups: Groups, point: Point, members: set[int]) -> float:
    """What a point leaves of some groups, squared, blocks centred, um^2."""
    total = 0.0
    for g in (groups.groups[k] for k in members):
        left = g.measured_um - g.predicted(point.model)
        for a, b in g.blocks:
            cut = left[:, a:b]
            total += float(((cut - cut.mean(axis=1, keepdims=True)) ** 2).sum())
    return total
