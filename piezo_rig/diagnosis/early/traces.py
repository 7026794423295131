"""What single recordings have of their own, thinned and whitened, for a search along the time.

With repeats a recording is compared with the mean of the others: whatever is locked to the drive
is gone. Without, it is compared with the model, and what a steady loop may still differ by is
left open.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes.mains_hum import ORDERS
from piezo_rig.diagnosis.groups import Group, Groups
from piezo_rig.diagnosis.noise import Spectrum, Whitener, spectrum_of
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]
SEEN_HZ = 1000.0  # what breaks change goes on for long: no more samples are needed
SHORTEST_S = 0.1
HATS, RISES = 14, 8
NONE = np.zeros((1, 0))
LOSSES = (1, 3, 9, 27, 81, 243)
LOUD = 4.0  # times the median variance: not taken for noise
PARTS, STEP = 16, 8  # of what comes before a memory is known; samples of a sudden step
UNLIKE, SUDDEN = 3.0, 0.5  # times that recordings differ more there; of that, within a step
EXACT = 1e-5  # of the travel: no sensor resolves more


@dataclass(frozen=True, eq=False)
class Stretch:
    """Samples begin..end of the recordings of one group: one sweep of each.

    Attributes
    ----------
    group, begin, end : which samples
    factor : by which they are thinned
    velocity : shape (m,), of the model, um per full-rate sample
    ways : shape (k, m), the same as a mean over the next so many samples, `LOSSES`
    nuisance : shape (k, m), what may differ without anything having happened
    """

    group: int
    begin: int
    end: int
    factor: int
    velocity: FloatArray
    ways: FloatArray
    nuisance: FloatArray

    def thinned(self, values: FloatArray) -> FloatArray:
        """Block averages of full-rate values (n,) of the stretch, shape (m,)."""
        m = (self.end - self.begin) // self.factor
        return values[: m * self.factor].reshape(m, self.factor).mean(axis=1)


def stretches(
    groups: Groups, predicted: Sequence[FloatArray], sweeps: Sequence[Sweep], line_hz: float | None
) -> list[Stretch]:
    """All stretches that can be searched; ``line_hz`` is that of a hum, left open as well."""
    factor = max(1, round(groups.rate / SEEN_HZ))
    least = max(64 * factor, int(SHORTEST_S * groups.rate))
    out = []
    for g, (group, model) in enumerate(zip(groups.groups, predicted, strict=True)):
        for begin, end in _bounds(group, sweeps):
            if end - begin < least:
                continue
            cut = slice(begin, end)
            speed = np.gradient(model[cut])
            made = Stretch(g, begin, end, factor, NONE[0], NONE, NONE)
            columns = _nuisance(group, cut, speed, groups.rate, line_hz)
            thin = np.array([made.thinned(c) for c in columns])
            ways = [made.thinned(way(model[cut], c) / c) for c in LOSSES if 4 * c < end - begin]
            out.append(
                Stretch(g, begin, end, factor, made.thinned(speed), np.array(ways), thin)
            )
    return out


def way(values: FloatArray, samples: int) -> FloatArray:
    """How far it goes within the next so many samples, (n,); at the end it stands still."""
    ahead = np.minimum(np.arange(values.size) + samples, values.size - 1)
    return values[ahead] - values


def _bounds(group: Group, sweeps: Sequence[Sweep]) -> list[tuple[int, int]]:
    if group.repeats < 2:  # a model predicts only where the memory is known
        return list(group.blocks)
    begin = comparable_from(group)
    return [(max(a, min(begin, b)), b) for a, b in sweep_bounds(group, 0, sweeps)]


def comparable_from(group: Group) -> int:
    """First sample from which recordings of one drive should be alike: all, or where their memory
    is known if they differ until then, and by far less from there on.

    The first of a session may rise from rest, its repeats do not. A step is damage, and is sought.
    """
    return 0 if group.virgin or not _begun_differently(group) else group.blocks[0][0]


def _begun_differently(group: Group) -> bool:
    begin, end = group.blocks[0]
    wide = max(begin // PARTS, STEP)
    if begin < 2 * wide or end - begin < 2 * wide:
        return False
    for row in group.measured_um - group.measured_um.mean(axis=0):
        before, after = (_averages(x, wide) for x in (row[:begin], row[begin:end]))
        before = np.append(before, after.mean())
        ahead = _averages(row[:begin], STEP)
        sudden = float(np.abs(np.diff(ahead)).max(initial=0.0))
        if np.ptp(before) > UNLIKE * np.ptp(after) and sudden < SUDDEN * np.ptp(before):
            return True
    return False


def _averages(values: FloatArray, wide: int) -> FloatArray:
    """Over parts of so many samples."""
    n = values.size // wide * wide
    return np.asarray(values[:n].reshape(-1, wide).mean(axis=1))


def sweep_bounds(group: Group, row: int, sweeps: Sequence[Sweep]) -> list[tuple[int, int]]:
    """First and one past last sample of every sweep of a recording."""
    edges = np.cumsum([0, *(sweeps[i].samples for i in group.sweeps[row])])
    edges = np.minimum(edges, group.drive_v.size)
    return [(int(a), int(b)) for a, b in pairwise(edges) if b > a]


def _nuisance(
    group: Group, cut: slice, speed: FloatArray, rate: float, line_hz: float | None
) -> list[FloatArray]:
    n = speed.size
    time = np.linspace(-1.0, 1.0, n)
    out = [np.ones(n), time, speed]  # an offset, a drift, a trigger that came late
    if line_hz is not None:
        angle = 2.0 * np.pi * line_hz * group.time_s[cut]
        orders = [k for k in ORDERS if k * line_hz < 0.45 * rate]
        out += [wave(k * angle) for k in orders for wave in (np.sin, np.cos)]
    if group.repeats > 1:
        return out
    drive = group.drive_v[cut]
    span = max(float(np.ptp(drive)), 1e-12)
    place = (drive - drive.min()) / span
    up = np.gradient(drive) >= 0.0
    first = np.zeros(n, bool)
    if group.virgin and len(group.loops):
        first = np.arange(cut.start, cut.stop) <= int(group.loops.stop[0])
    # a clock that runs fast, creep
    out += [speed * time, np.log1p(np.arange(n) / rate / 0.05)]
    for members, count in ((first, RISES), (up & ~first, HATS), (~up & ~first, HATS)):
        at = np.linspace(0.0, 1.0, count)
        out += [np.interp(place, at, hat) * members for hat in np.eye(count)]
    return out


def own_part(group: Group, row: int, predicted: FloatArray) -> FloatArray:
    """What a recording has of its own, shape (n,)."""
    measured = group.measured_um
    if group.repeats < 2:
        return measured[row] - predicted
    return measured[row] - np.delete(measured, row, axis=0).mean(axis=0)


@dataclass(frozen=True, eq=False)
class Whitened:
    """A stretch in a space where its noise is white.

    ``base`` : shape (k, m), orthonormal, the nuisance there
    """

    stretch: Stretch
    whitener: Whitener
    base: FloatArray

    @classmethod
    def of(cls, stretch: Stretch, whitener: Whitener) -> Whitened:
        return cls(stretch, whitener, _orthonormal(whitener(stretch.nuisance)))

    def project(self, rows: NDArray[Any]) -> FloatArray:
        """Whitened rows (..., m) with what the nuisance can do taken off."""
        white, base = self.whitener(rows), self.base.astype(rows.dtype, copy=False)
        return white - (white @ base.T) @ base

    def near(self, at: int, within: float) -> Callable[[FloatArray], FloatArray]:
        """`project`, of what lies within so many full-rate samples of one of them alone."""
        if not np.isfinite(within):
            return self.project
        m = self.stretch.velocity.size
        off = (np.arange(m) + 0.5) * self.stretch.factor - (at - self.stretch.begin)
        cut = slice(*np.searchsorted(off, [-within, within]))
        local = np.array([np.ones(m), self.stretch.velocity])
        base = _orthonormal(self.whitener(local)[:, cut])

        def projected(rows: FloatArray) -> FloatArray:
            white = self.whitener(rows)[..., cut]
            return white - (white @ base.T) @ base

        return projected

    def back(self, white: FloatArray) -> FloatArray:
        """The transposed filter, so that <filtered a, b> = <a, back(b)>; shape (m,)."""
        return self.whitener(white[::-1])[::-1]


def _orthonormal(rows: FloatArray) -> FloatArray:
    size = np.linalg.norm(rows, axis=1)
    rows = rows[size > 0] / size[size > 0, None]
    values, vectors = np.linalg.eigh(rows @ rows.T)
    kept = values > 1e-9 * values[-1]
    return (vectors[:, kept] / np.sqrt(values[kept])).T @ rows


def spectrum(
    groups: Groups, found: Sequence[Stretch], own: dict[tuple[int, int], FloatArray]
) -> Spectrum:
    """Of what recordings have of their own; those that are much louder than most count for nothing.

    ``own`` : (number of the stretch, recording) -> its own part, thinned
    """
    parts = []
    for (k, _), values in own.items():
        base = _orthonormal(found[k].nuisance)
        parts.append(values - (values @ base.T) @ base)
    # of first differences: what breaks a recording makes it louder at low frequencies
    power = np.array([float(np.var(p)) for p in parts])
    kept = [p for p, v in zip(parts, power, strict=True) if v <= LOUD * np.median(power)]
    share = 1.0 if groups.repeats < 2 else (groups.repeats - 1) / groups.repeats
    least = (EXACT * groups.travel_um) ** 2
    return spectrum_of(kept, share, least)
