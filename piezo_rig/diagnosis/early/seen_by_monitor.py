"""Samples that a digitizer lost, seen by the drive monitor that it recorded beside the sensor.

The monitor is the drive, late by a constant; behind a loss it comes earlier by a whole number of
samples, and stays so. What an amplifier does to a drive comes again with every cycle, and clocks
that run apart are apart by more and more: neither is a step. A step shows beside noise of a few
millivolts what the displacement shows beside everything that a model of an actuator lacks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain.relaxation import off_each
from piezo_rig.diagnosis.early.mended import DROP, Break, moved
from piezo_rig.diagnosis.early.traces import sweep_bounds
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]
Samples = NDArray[np.int64]
SHORTEST = 400  # samples of a sweep
PARTS, PART = 8, 200  # in the quietest of which a monitor is learnt; samples of each at least
WINDOWS, LEAST = 128, 24  # whose lags are compared; samples of each at least
SIDE = 2  # windows, and at least so many, to either side of a loss
STEP = 0.5  # samples by which lags must differ
MOST_LOST = 400  # samples at once, that are looked for
CORRELATED = 10.0  # samples of a monitor that count as one
PLAIN = 50.0  # log-likelihood by which a loss is plain
FURTHER = 1.0  # the same, by which one more sample must be likelier
MUCH = 10.0 * PLAIN  # that a window may say
UNKNOWN = 9.0  # mean square, of that where a monitor was learnt, beyond where the drive is known
SURE = 3.0  # the same, by which other places must be worse
WHOLE = 0.25  # samples by which what is left of a step may differ from none
ALIKE = 2.0  # times what is left where a monitor was learnt, that may be left on the whole
MOVES = 0.5  # of what a part moves at most, below which nothing is learnt from it
LEARNT = 2  # parts that are tried
EVERY, NEAR = 3, 3  # samples between places that are tried; off which a lag may take it
STILL = 1e-3  # the same of a window, below which its lag is not known
LAGS = (1.0, 3.0, 9.0)  # samples, of which an amplifier's may be made up
BEGIN = 100  # samples, in which what was before has its say
SAME = 1e-4  # of the largest, below which what such lags do is the same
LEAST_CHANCE = 1e-300
FOLLOWS = 0.02  # rms misfit, of the drive's, above which it is no monitor of this drive

Loss = tuple[int, int]  # the record's first sample behind it, and how many are missing


@dataclass(frozen=True)
class Seen:
    """One loss of a sweep: the record's first sample behind it, how many are missing, between
    which samples it may be as well, and the chance that it is none.
    """

    index: int
    count: int
    low: int
    high: int
    chance: float


def losses_of_monitors(groups: Groups, sweeps: Sequence[Sweep]) -> list[Break]:
    """Losses that monitors show, each at its sample; none where there is no monitor."""
    out: list[Break] = []
    for g, row, begin, end, i in _recorded(groups, sweeps):
        monitor = sweeps[i].drive_monitor_v
        if monitor is None or end - begin < SHORTEST:
            continue
        drive, seen = groups.groups[g].drive_v[begin:end], monitor[: end - begin]
        if seen.size == drive.size and np.isfinite(seen).all():
            out += [
                Break(DROP, g, row, begin + b.index, b.count, begin + b.low, begin + b.high, end,
                      b.chance, sure=True)
                for b in _losses(drive, seen)
            ]  # fmt: skip
    return out


def with_monitors_mended(
    sweeps: Sequence[Sweep], groups: Groups, losses: Sequence[Break]
) -> list[Sweep]:
    """Sweeps with monitors that are as if nothing had been lost."""
    out = list(sweeps)
    for g, row, begin, end, i in _recorded(groups, sweeps):
        mine = [
            replace(b, index=b.index - begin, low=b.low - begin, high=b.high - begin,
                    end=b.end - begin)
            for b in losses if (b.group, b.row) == (g, row) and begin <= b.index < end
        ]  # fmt: skip
        monitor = sweeps[i].drive_monitor_v
        if mine and monitor is not None:
            whole = monitor.copy()
            drive = groups.groups[g].drive_v[begin:end]
            whole[: end - begin] = moved(monitor[: end - begin], drive, mine)
            out[i] = replace(out[i], drive_monitor_v=whole)
    return out


def _recorded(
    groups: Groups, sweeps: Sequence[Sweep]
) -> Iterator[tuple[int, int, int, int, int]]:
    """Group, recording, first and one past last sample there, and number of every sweep."""
    for g, group in enumerate(groups.groups):
        for row, members in enumerate(group.sweeps):
            for (begin, end), i in zip(sweep_bounds(group, row, sweeps), members, strict=False):
                yield g, row, begin, end, i


def _losses(drive: FloatArray, seen: FloatArray) -> list[Seen]:
    """Every loss of a sweep, from its drive (n,) and its monitor (n,), volts."""
    follows = _Follows(drive, seen)
    if not follows.lag_falls():
        return []
    found = [_plain(follows, heard, least) for heard, least in follows.learnt()]
    return min((f for f in found if f), key=follows.misfit, default=[])


def _plain(follows: _Follows, heard: FloatArray, least: float) -> list[Seen]:
    """The losses without which more is left; none where much is left beside them.

    Parameters
    ----------
    heard : what the monitor would be of the whole drive, shape (n,), volts
    least : mean square of what is left where that was learnt
    """
    losses = follows.losses(heard, least)
    while losses:
        left = follows.left(losses)
        gains = [
            _gained(left, follows.left([b for b in losses if b is not loss])) for loss in losses
        ]
        k = int(np.argmin(gains))
        if gains[k] > PLAIN:
            break
        losses.pop(k)
    if not losses or float(np.mean(left**2)) > ALIKE**2 * least:
        return []
    if any(abs(follows.falls_by(left, losses, index)) > WHOLE for index, _ in losses):
        return []
    out = []
    for k, (index, count) in enumerate(losses):
        low, high = follows.between(heard, least, losses, k)
        chance = max(LEAST_CHANCE, min(1.0, follows.size * float(np.exp(-min(gains[k], 690.0)))))
        out.append(Seen(index, count, low, high, chance))
    return out


def _gained(left: FloatArray, other: FloatArray) -> float:
    """Log-likelihood of what is left against what is left otherwise."""
    n = min(left.size, other.size)
    now, then = float(np.mean(left[:n] ** 2)), float(np.mean(other[:n] ** 2))
    return 0.5 * n / CORRELATED * float(np.log(then / max(now, 1e-300)))


class _Follows:
    """A monitor, and all that one of this drive may be made of: the drive, its speed, its lags."""

    def __init__(self, drive: FloatArray, seen: FloatArray) -> None:
        self.seen, self.size = seen, drive.size
        self.slope = np.gradient(drive)
        samples, begins = np.arange(drive.size, dtype=float), np.zeros(1, dtype=np.int64)
        played = np.ascontiguousarray(drive)
        behind = [off_each(begins, samples, played, lag) for lag in LAGS]
        self.rows = np.column_stack([np.ones(drive.size), drive, self.slope, *behind])
        self.wide = max(LEAST, drive.size // WINDOWS)

    def at(self, losses: Sequence[Loss]) -> Samples:
        """The drive's samples that were recorded, as far as the drive is known; (m,)."""
        at = np.arange(self.size)
        for index, count in losses:
            at[index:] += count
        return at[: int(np.searchsorted(at, self.size))]

    def left(self, losses: Sequence[Loss]) -> FloatArray:
        """What is left of the monitor, volts, also of one that comes ever later; (m,)."""
        at = self.at(losses)
        later = np.linspace(0.0, 1.0, at.size) * self.slope[at]
        rows, seen = np.column_stack([self.rows[at], later]), self.seen[: at.size]
        left = seen - rows @ _shares(rows[BEGIN:], seen[BEGIN:])
        left[:BEGIN] = 0.0
        return np.asarray(left)

    def misfit(self, losses: Sequence[Seen]) -> float:
        """Mean square of what is left, volts."""
        return float(np.mean(self.left([(b.index, b.count) for b in losses]) ** 2))

    def falls_by(self, left: FloatArray, losses: Sequence[Loss], index: int) -> float:
        """By how many samples what is left comes earlier behind a place than before it."""
        slope = self.slope[self.at(losses)]
        before, after = (
            float(e @ s) / max(float(s @ s), 1e-300)
            for e, s in ((left[:index], slope[:index]), (left[index:], slope[index:]))
        )
        return after - before

    def lag_falls(self) -> bool:
        """Whether the monitor seems to come earlier from some place on."""
        drive = self.rows[:, 1] - self.rows[:, 1].mean()
        gain = float(drive @ self.seen / max(float(drive @ drive), 1e-300))
        left = self.seen - self.rows[:, :3] @ _shares(self.rows[:, :3], self.seen)
        cut = self.size // self.wide * self.wide
        speed = (gain * self.slope)[:cut].reshape(-1, self.wide)
        moves = np.sum(speed**2, axis=1)
        early = np.sum(left[:cut].reshape(-1, self.wide) * speed, axis=1)
        known = moves > STILL * moves.max(initial=0.0)
        total, first = np.cumsum(np.where(known, moves, 0.0)), np.cumsum(early * known)
        k = np.arange(SIDE, moves.size - SIDE)
        if not k.size or total[-1] <= 0.0:
            return False
        before = first[k - 1] / np.maximum(total[k - 1], 1e-300)
        after = (first[-1] - first[k - 1]) / np.maximum(total[-1] - total[k - 1], 1e-300)
        return bool((after - before).max() > STEP)

    def learnt(self) -> Iterator[tuple[FloatArray, float]]:
        """What the monitor would be of the whole drive, as parts of it have it, and the mean
        square of what is left there.

        The first part, before which nothing is lost, the quietest, and those that are quietest
        where they are moved to where they would be behind a loss.
        """
        long = max(PART, self.size // PARTS)
        parts = list(range(BEGIN, self.size - long + 1, long))
        spans = [float(np.ptp(self.rows[p : p + long, 1])) for p in parts]
        parts = [p for p, span in zip(parts, spans, strict=True) if span > MOVES * max(spans)]

        def at(begin: int, shift: int) -> tuple[float, FloatArray]:
            there = self.rows[begin + shift : begin + shift + long]
            seen = self.seen[begin : begin + there.shape[0]]
            shares = _shares(there, seen)
            return float(np.mean((seen - there @ shares) ** 2)), shares

        def good(found: tuple[float, FloatArray]) -> bool:
            return bool(np.sqrt(found[0]) < FOLLOWS * float(np.std(self.seen)))

        plain = [at(p, 0) for p in parts]
        order = np.argsort([left for left, _ in plain])[:LEARNT]
        for k in dict.fromkeys([0, *order.tolist()]):
            if good(plain[k]):
                yield self.rows @ plain[k][1], max(plain[k][0], 1e-300)
        later = [p for p in parts if p + 2 * long <= self.size][-LEARNT:]
        for p in later:
            most = min(MOST_LOST, self.size - p - long)
            moved = min((at(p, s) for s in range(EVERY, most, EVERY)), key=lambda f: f[0])
            if good(moved):
                yield self.rows @ moved[1], max(moved[0], 1e-300)

    def losses(self, heard: FloatArray, least: float) -> list[Loss]:
        """Losses by which a monitor comes ever earlier: the likeliest way through all shifts."""
        most = min(MOST_LOST, self.size // PARTS)
        shifts, windows = np.arange(-NEAR, most + 1), self.size // self.wide
        cut = windows * self.wide
        own = np.arange(cut)
        cost = np.empty((windows, shifts.size))
        for j, shift in enumerate(shifts):
            there = own + shift
            off = (self.seen[:cut] - heard[np.clip(there, 0, self.size - 1)]) ** 2
            off[(there < 0) | (there >= self.size)] = UNKNOWN * least
            off[:BEGIN] = 0.0
            cost[:, j] = off.reshape(windows, -1).sum(axis=1)
        usual = float(np.median(cost.min(axis=1))) / self.wide  # elsewhere it may be less quiet
        # in the midst of a window all shifts are wrong, and one that is by chance less is no better
        cost = np.minimum(cost / (2.0 * CORRELATED * max(least, usual)), MUCH)
        came = np.zeros((windows, shifts.size), dtype=int)
        each = np.arange(shifts.size)
        worth = np.where(np.abs(shifts) <= NEAR, cost[0], np.inf)
        for w in range(1, windows):
            beside = worth - FURTHER * each  # drives come again: the fewest that are missing
            lowest = np.minimum.accumulate(beside)
            where = np.maximum.accumulate(np.where(beside <= lowest, each, 0))
            moved = lowest + FURTHER * each + PLAIN
            came[w] = np.where(worth <= moved, each, where)
            worth = cost[w] + np.minimum(worth, moved)
        way = [int(np.argmin(worth))]
        for w in range(windows - 1, 0, -1):
            way.append(int(came[w, way[-1]]))
        way.reverse()
        out = list[Loss]()
        w = 1
        while w < windows:
            first = w
            while w < windows and way[w] > way[w - 1]:  # one in the midst of a window shows in two
                w += 1
            if w > first:
                begin, end = (first - 1) * self.wide, min(w * self.wide, self.size)
                before, after = int(shifts[way[first - 1]]), int(shifts[way[w - 1]])
                at = begin + int(np.argmin(self._costs(heard, begin, end, before, after)))
                out.append((at, after - before))
            w += 1
        return out

    def between(
        self, heard: FloatArray, least: float, losses: Sequence[Loss], k: int
    ) -> tuple[int, int]:
        """Lowest and highest sample at which a loss may be."""
        index = losses[k][0]
        begin = max(index - self.wide, losses[k - 1][0] if k else 0)
        end = min(index + self.wide, losses[k + 1][0] if k + 1 < len(losses) else self.size)
        before = self._first(heard) + sum(count for _, count in losses[:k])
        cost = self._costs(heard, begin, end, before, before + losses[k][1])
        good = np.flatnonzero(cost < cost.min() + SURE * 2.0 * CORRELATED * least)
        return min(begin + int(good[0]), index), max(begin + int(good[-1]), index)

    def _first(self, heard: FloatArray) -> int:
        """By how many samples a lag took what was learnt off the drive."""
        seen = self.seen[BEGIN : BEGIN + PART]
        near = range(-NEAR, NEAR + 1)
        return min(near, key=lambda s: float(
            np.sum((seen - heard[BEGIN + s : BEGIN + s + seen.size]) ** 2)
        ))  # fmt: skip

    def _costs(
        self, heard: FloatArray, begin: int, end: int, before: int, after: int
    ) -> FloatArray:
        """Squared misfit where one shift becomes another at every sample of a part."""
        own = np.arange(begin, end)
        first, later = (
            (self.seen[begin:end] - heard[np.clip(own + shift, 0, self.size - 1)]) ** 2
            for shift in (before, after)
        )
        return np.asarray(np.cumsum(first) - first + np.cumsum(later[::-1])[::-1])


def _shares(rows: FloatArray, seen: FloatArray) -> FloatArray:
    """Of every column (n, k) in what was seen (n,)."""
    size = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
    shares, *_ = np.linalg.lstsq(rows / size, seen, rcond=SAME)
    return np.asarray(shares / size)
