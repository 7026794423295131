"""Lost samples of a drive that holds, by how far its recordings are ahead of each other in between.

What is lost in a hold shows only when the drive moves again, and where each of several recordings
has lost some there, none of them is a step that lasts. But from one ramp to the next a recording
can only have lost a whole number of samples: each ramp is laid over that of another recording, with
so many lost before it or inside, and what leaves least is what was lost.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from piezo_rig.diagnosis.early.mended import DROP, Break
from piezo_rig.diagnosis.early.place import rests_of
from piezo_rig.diagnosis.early.traces import comparable_from, sweep_bounds
from piezo_rig.diagnosis.groups import Group
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]
Counts = tuple[int, ...]  # samples that each recording has lost by then
HELD, MARGIN = 40, 60  # samples: of a hold at least, and of one beside a ramp at most
MOST, FEW = 40, 3  # samples that one recording may lose in a hold, or each of two
SURE, DEAR = 8.0, 12.0  # log-likelihood by which others must be worse; for one loss more
FAR = 3.0  # times the variance in holds, that a ramp may be off at most
LOUD, MANY = 4.0, 20  # times the usual variance, of a hold that does not count; losses
LONG = 30_000_000  # samples of a ramp, times the ways in which some may be lost, that are looked at


class Ramp(NamedTuple):
    """Samples begin..end over which a drive moves; the hold before it begins at ``held``, the one
    after ends at ``until``.
    """

    held: int
    begin: int
    end: int
    until: int


class Seen(NamedTuple):
    """What recordings have lost as a ramp begins, and as it ends; from which sample on, and between
    which ones that may be.
    """

    first: Counts
    last: Counts
    at: int
    low: int
    high: int


def losses_between_holds(
    group: Group, g: int, predicted: FloatArray, sweeps: Sequence[Sweep]
) -> list[Break]:
    """All losses that the ramps of two or more recordings of one drive ask for; none where any ramp
    is in doubt, or nothing is held.

    Parameters
    ----------
    group : recordings that are not mended
    g : its number
    predicted : shape (n,), um
    """
    if group.repeats < 2:
        return []
    out, known = list[Break](), comparable_from(group)
    for begin, end in sweep_bounds(group, 0, sweeps):
        if begin < known < end:
            continue  # what recordings begin with differs
        laid = LaidOver.of(group.measured_um[:, begin:end], predicted[begin:end])
        seen = list(laid.seen()) if laid is not None else []
        if laid is None or len(seen) < len(laid.ramps):
            continue
        out += _losses(seen, laid.ramps, g, begin, end)
    return out if len(out) <= MANY else []


def ramps_of(path: FloatArray) -> list[Ramp]:
    """Where a path (n,) moves, between holds and its ends."""
    holds = [(a, b) for a, b in rests_of(path) if b - a >= HELD]
    beside = [(0, 0), *(h for h in holds if h[0] > 0), (path.size, path.size)]
    if holds and holds[0][0] == 0:
        beside[0] = holds[0]
    if holds and holds[-1][1] == path.size:
        beside.pop()
    return [Ramp(a[0], a[1], b[0], b[1]) for a, b in pairwise(beside) if b[0] > a[1]]


@dataclass(frozen=True, eq=False)
class LaidOver:
    """Recordings of one drive, (R, n), and what they follow, (n,), um.

    ``rho``, ``sigma`` : of what each has beyond the first in holds, the correlation of neighbouring
    samples and the variance of what is new in each, um^2; shape (R - 1,)
    """

    rows: FloatArray
    path: FloatArray
    ramps: list[Ramp]
    rho: FloatArray
    sigma: FloatArray

    @classmethod
    def of(cls, rows: FloatArray, path: FloatArray) -> LaidOver | None:
        """None of a drive that does not hold between ramps."""
        ramps = ramps_of(path)
        holds = [(a.end, b.begin) for a, b in pairwise(ramps)]
        if not holds:
            return None
        rho, sigma = list[float](), list[float]()
        for own in rows[1:] - rows[0]:
            # one that is ahead moves before a hold of the other one ends
            rests = [own[a : max(b - MOST, a + HELD // 2)] for a, b in holds]
            rests = [x - x.mean() for x in rests]
            usual = float(np.median([np.mean(x**2) for x in rests]))
            if not usual > 0.0:
                return None
            rests = [x for x in rests if np.mean(x**2) < LOUD * usual]
            power = sum(float(x @ x) for x in rests)
            rho.append(min(max(sum(float(x[1:] @ x[:-1]) for x in rests) / power, 0.0), 0.98))
            new = np.concatenate([x[1:] - rho[-1] * x[:-1] for x in rests])
            sigma.append(float(np.mean(new**2)))
        return cls(rows, path, ramps, np.array(rho), np.array(sigma))

    def seen(self) -> Iterator[Seen]:
        """Ramp by ramp, up to one that is in doubt."""
        lost: Counts = (0,) * len(self.rows)
        for ramp in self.ramps:
            seen = self._seen_in(ramp, lost)
            if seen is None:
                return
            yield seen
            lost = seen.last

    def _seen_in(self, ramp: Ramp, lost: Counts) -> Seen | None:
        """In one ramp, with what was lost before the hold that it follows."""
        begin = max(ramp.held, ramp.begin - max(lost) - MOST - MARGIN)
        # behind the last sample nobody knows how a drive goes on
        end = min(ramp.end + MARGIN, ramp.until, self.path.size - max(lost) - 2 * FEW)
        index = np.arange(begin, end)
        held = (index < ramp.begin - max(lost) - MOST) | (index >= ramp.end)
        if not held.any():
            return None
        own = self.rows[1:, index] - self.rows[0, index]
        own = own - own[:, held].mean(axis=1, keepdims=True)
        several = [c for c in _more(lost) if sum(c) - sum(lost) <= MOST]
        if index.size * len(several) > LONG:
            return None
        cost = {c: self._cost(index, own, c) for c in several}
        dear = {c: DEAR * sum(a != b for a, b in zip(c, lost, strict=True)) for c in several}
        order = sorted(several, key=lambda c: float(cost[c][-1]) + dear[c])
        best, least = order[0], float(cost[order[0]][-1]) + dear[order[0]]
        sure = len(order) < 2 or float(cost[order[1]][-1]) + dear[order[1]] > least + SURE
        seen = Seen(best, best, ramp.begin, ramp.begin, ramp.begin) if sure else None
        for first in order[: 2 * len(lost) + 2]:
            moved = index > ramp.begin - max(first)  # before it a loss is one in the hold
            for last in _one_more(first):
                if last not in cost:
                    cost[last] = self._cost(index, own, last)
                both = np.where(moved, cost[first] + (cost[last][-1] - cost[last]), np.inf)
                at = int(np.argmin(both))
                worth = float(both[at]) + dear[first] + DEAR
                if worth < least:
                    good = index[0] + 1 + np.flatnonzero(both < both[at] + SURE)
                    least, seen = worth, Seen(
                        first, last, int(index[0]) + 1 + at, int(good[0]), int(good[-1])
                    )
        usual = 0.5 * index.size * len(own)
        return seen if least < FAR * usual else None

    def _cost(self, index: NDArray[np.int64], own: FloatArray, lost: Counts) -> FloatArray:
        """Up to every sample, shape (n,): what is left with so many lost, a negative
        log-likelihood.
        """
        there = [self.path[np.minimum(index + k, self.path.size - 1)] for k in lost]
        left = own - (np.array(there[1:]) - there[0])
        new = left.copy()
        new[:, 1:] -= self.rho[:, None] * left[:, :-1]
        return np.asarray(np.cumsum(np.sum(new**2 / (2.0 * self.sigma[:, None]), axis=0)))


def _more(lost: Counts) -> list[Counts]:
    """As many as before, many more of one recording, a few more of two."""
    out = [lost]
    for row in range(len(lost)):
        out += [_with(lost, row, k) for k in range(1, MOST + 1)]
        for other in range(row):
            out += [_with(_with(lost, row, k), other, j)
                    for k in range(1, FEW + 1) for j in range(1, FEW + 1)]  # fmt: skip
    return out


def _one_more(lost: Counts) -> list[Counts]:
    """A loss of one recording more."""
    return [_with(lost, row, k) for row in range(len(lost)) for k in range(1, FEW + 1)]


def _with(lost: Counts, row: int, more: int) -> Counts:
    return (*lost[:row], lost[row] + more, *lost[row + 1 :])


def _losses(
    seen: Sequence[Seen], ramps: Sequence[Ramp], g: int, begin: int, end: int
) -> list[Break]:
    """Every loss at its place in the recording that has it; one in a hold in the middle of that."""
    out, before = list[Break](), tuple(0 for _ in seen[0].first)
    for ramp, now in zip(ramps, seen, strict=True):
        middle = (ramp.held + ramp.begin) // 2
        for row, (a, b, c) in enumerate(zip(before, now.first, now.last, strict=True)):
            if b > a:
                index = begin + middle - a
                out.append(Break(DROP, g, row, index, b - a, index, index, end, 1.0))
            if c > b:
                out.append(Break(
                    DROP, g, row, begin + now.at, c - b, begin + now.low, begin + now.high, end, 1.0
                ))  # fmt: skip
        before = now.last
    return out
