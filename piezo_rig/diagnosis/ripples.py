"""Errors that repeat with displacement, at any period: a scale's grating, an interpolator, a screw;
or with the drive: a converter whose steps are not alike.

No cause of the catalogue but at half a wavelength, so at most "unexplained"; sought in what a model
leaves, as lines are in clock time. What the base model is wrong by goes with the drive since it
turned, and is no line over displacement or drive that rises and falls alike. Such an error is set
aside before causes are looked for, which would be taken for it: no element of a base can follow it,
but many laws can a little.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes.periodic_nonlinearity import HALF_WAVE_UM
from piezo_rig.chain import Model
from piezo_rig.diagnosis.early.hum import Row
from piezo_rig.diagnosis.early.lines import FAR, spectrum_of, summit
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.groups import Group, Groups

FloatArray = NDArray[np.float64]
STEP_UM, STEP_V = 0.02, 0.2
SAMPLES, FEWEST = 4, 40  # in a step, on the average; steps
HIGHEST = 0.25  # periods in a step
FILLED = 0.8  # of all steps
ORDERS_OFF = 3  # that are taken off
LONG = 0.5  # of the furthest travel
ORDERS = 0.5, 1.5, 2.0, 3.0  # of a line, where others of the same ripple may be
PARTS, AGREE = 3, 0.8  # of the travel; of their power, that is left where they are added up
UNLIKE = 0.5  # of a line's power, that rising and falling differ by at most
NEAR, LESS = 3.0, 0.8  # times others' power, to be tried; squared error that it must leave then
JOINTLY, STILL = 12, 0.01  # turns of fitting base and ripple, until so little changes
LEAST_PERIODS = 3.0  # over the travel of a block, for its share to be told from elements
AS_WELL = 0.95  # squared error that one phase for all takes off, of what one for each does
SAME = 0.25  # of the resolution of a period, by which two are the same
SCALE_OFF = 0.05  # by which half a wavelength would be another, were the sensitivity wrong


@dataclass(frozen=True)
class Ripple:
    """The strongest: period in um, rms in nm, and its chance among all periods."""

    period_um: float
    rms_nm: float
    p_value: float
    over: ClassVar[str] = "displacement"

    @property
    def period(self) -> float:
        return self.period_um

    @property
    def often(self) -> str:
        """Its period in words."""
        return f"{1e3 * self.period_um:.4g} nm"

    @staticmethod
    def along(group: Group, predicted: FloatArray) -> FloatArray:
        """What it repeats with, in the unit of its period, (n,)."""
        return predicted

    @property
    def text(self) -> str:
        ratio = self.period_um / HALF_WAVE_UM
        text = f"an error that comes back every {self.often} of displacement"
        if abs(ratio - 1.0) > SCALE_OFF:
            return text
        return (f"{text}; an interferometer's comes every {1e3 * HALF_WAVE_UM:.4g} nm, and would "
                f"be this one if the sensitivity were {1.0 / ratio:.4g} times what was "
                "said")  # fmt: skip


@dataclass(frozen=True)
class DriveRipple:
    """The same over the drive, as of a converter whose steps are not alike; ``period_v`` in V."""

    period_v: float
    rms_nm: float
    p_value: float
    over: ClassVar[str] = "drive"

    @property
    def period(self) -> float:
        return self.period_v

    @property
    def often(self) -> str:
        """Its period in words."""
        return f"{self.period_v:.3g} V"

    @staticmethod
    def along(group: Group, predicted: FloatArray) -> FloatArray:
        """What it repeats with, in the unit of its period, (n,)."""
        return group.drive_v

    @property
    def text(self) -> str:
        return (f"an error that comes back every {self.often} of the drive, as of a "
                "generator whose steps are not alike")  # fmt: skip


AnyRipple = Ripple | DriveRipple


@dataclass(frozen=True, eq=False)
class Aside:
    """A ripple, recordings without it, and what a baseline leaves of these, um^2."""

    ripple: AnyRipple
    groups: Groups
    left: float


def set_aside(
    groups: Groups, point: Point, refitted: Callable[[Groups, Point], Point], level: float
) -> Aside | None:
    """What a baseline leaves of a ripple, taken off by turns with what the baseline made of it.

    Over displacement or over the drive, whichever leaves less. None without a plain one, and where
    it is the interferometer's own, which has a name.

    ``level`` : family-wise chance of a false alarm
    """
    own = find_ripple(groups, point.model)
    if own is not None and _of_half_a_wave(own, groups):
        return None
    found = [_set_aside(find, groups, point, refitted, level)
             for find in (find_ripple, find_drive_ripple)]  # fmt: skip
    return min((f for f in found if f is not None), key=lambda f: f.left, default=None)


def _set_aside(
    find: Callable[[Groups, Model, float], AnyRipple | None], groups: Groups, point: Point,
    refitted: Callable[[Groups, Point], Point], level: float,
) -> Aside | None:  # fmt: skip
    ripple = find(groups, point.model, NEAR)
    if ripple is None or _of_half_a_wave(ripple, groups):
        return None
    before, clean = left_of(groups, point.model), without(groups, point.model, ripple)
    plain = find(groups, point.model, FAR)
    taken_nm = 0.0
    for _ in range(JOINTLY):  # what the base has taken of it is given back
        point = refitted(clean, point)
        ripple = find(groups, point.model, NEAR) or ripple
        clean = without(groups, point.model, ripple)
        before_nm, taken_nm = taken_nm, _taken_nm(groups, clean)
        if abs(taken_nm - before_nm) < STILL * taken_nm:
            break
    else:  # the more is taken off, the more the base makes up for: it was the base's own
        return None
    left = left_of(clean, refitted(clean, point).model)
    if plain is None or plain.p_value > level:
        plain = find(groups, point.model, FAR)
        if left > LESS * before:
            return None
    if plain is None or plain.p_value > level or _of_half_a_wave(ripple, groups):
        return None
    return Aside(replace(ripple, rms_nm=taken_nm), clean, left)


def left_of(groups: Groups, model: Model) -> float:
    """What a model leaves of the means over repeats, every block from its own mean; um^2."""
    total = 0.0
    for g in groups.groups:
        left = g.measured_um.mean(axis=0) - g.predicted(model)
        total += sum(float(np.sum((left[a:b] - left[a:b].mean()) ** 2)) for a, b in g.blocks)
    return total


def without(groups: Groups, model: Model, ripple: AnyRipple) -> Groups:
    """Recordings less what is best explained by a ripple of that period.

    All blocks together, as they stand where all begin at one place of the sensor's scale; where
    they do not, block by block, and short ones not at all.
    """
    pieces = [_Piece.of(g, g.predicted(model), ripple) for g in groups.groups]
    shares = _shares([x for p in pieces for x in p.columns], [y for p in pieces for y in p.left])
    lasting = [
        (x, y) for p in pieces for x, y, n in zip(p.columns, p.left, p.periods, strict=True)
        if n >= LEAST_PERIODS
    ]  # fmt: skip
    square = sum(float(y @ y) for _, y in lasting)
    joint = square - sum(float(np.sum((y - shares @ x) ** 2)) for x, y in lasting)
    apart = square - sum(float(np.sum((y - _shares([x], [y]) @ x) ** 2)) for x, y in lasting)
    known = shares if joint >= AS_WELL * apart else None
    return groups.with_([
        g.with_measured(g.measured_um - p.off(known))
        for g, p in zip(groups.groups, pieces, strict=True)
    ])  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Piece:
    """One group: of every block, sines and cosines and what is left, each from its own mean."""

    size: int
    blocks: tuple[tuple[int, int], ...]
    columns: list[FloatArray]
    left: list[FloatArray]
    periods: list[float]

    @classmethod
    def of(cls, group: Group, predicted: FloatArray, ripple: AnyRipple) -> _Piece:
        left = group.measured_um.mean(axis=0) - predicted
        along, columns = ripple.along(group, predicted), []
        for a, b in group.blocks:
            angle = 2.0 * np.pi / ripple.period * np.arange(1, ORDERS_OFF + 1)[:, None]
            both = np.concatenate([np.sin(angle * along[a:b]), np.cos(angle * along[a:b])])
            columns.append(both - both.mean(axis=1, keepdims=True))
        return cls(
            predicted.size, group.blocks, columns,
            [left[a:b] - left[a:b].mean() for a, b in group.blocks],
            [float(np.ptp(along[a:b])) / ripple.period for a, b in group.blocks],
        )  # fmt: skip

    def off(self, shares: FloatArray | None) -> FloatArray:
        """What is taken off (n,), with shares (k,) that all blocks have or each its own."""
        out = np.zeros(self.size)
        for (a, b), x, y, n in zip(self.blocks, self.columns, self.left, self.periods, strict=True):
            if shares is not None:
                out[a:b] = shares @ x
            elif n >= LEAST_PERIODS:
                out[a:b] = _shares([x], [y]) @ x
        return out


def _shares(columns: Sequence[FloatArray], left: Sequence[FloatArray]) -> FloatArray:
    """Least squares of all blocks together, (k,)."""
    x, y = np.concatenate(columns, axis=1), np.concatenate(left)
    return np.asarray(np.linalg.lstsq(x @ x.T, x @ y, rcond=None)[0])


def _taken_nm(groups: Groups, clean: Groups) -> float:
    changes = [
        (g.measured_um[0] - c.measured_um[0])[a:b]
        for g, c in zip(groups.groups, clean.groups, strict=True) for a, b in g.blocks
    ]  # fmt: skip
    return 1e3 * float(np.sqrt(np.mean(np.concatenate(changes) ** 2)))


def _of_half_a_wave(ripple: AnyRipple, groups: Groups) -> bool:
    """Whether it is one of the first two orders of the interferometer's error."""
    if not isinstance(ripple, Ripple):
        return False
    resolution = ripple.period_um**2 / groups.travel_um
    return any(
        abs(ripple.period_um - HALF_WAVE_UM / order) < SAME * resolution for order in (1, 2)
    )


def find_ripple(groups: Groups, model: Model, far: float = FAR) -> Ripple | None:
    """A line over displacement that stands far above all others but its own overtones.

    ``far`` : times their power
    """
    found = _line(groups, model, Ripple.along, STEP_UM, far)
    return found and Ripple(*found)


def find_drive_ripple(groups: Groups, model: Model, far: float = FAR) -> DriveRipple | None:
    """The same over the drive."""
    found = _line(groups, model, DriveRipple.along, STEP_V, far)
    return found and DriveRipple(*found)


def _line(
    groups: Groups, model: Model, over: Callable[[Group, FloatArray], FloatArray], step: float,
    far: float,
) -> tuple[float, float, float] | None:  # fmt: skip
    """Period, rms in nm and chance of a line over whatever a group says, in steps of that."""
    ways = [w for g in groups.groups for w in _rows(g, model, over, step)]
    furthest = max((float(w.alike.time_s[-1]) for w in ways), default=0.0)
    ways = [w for w in ways if w.alike.time_s[-1] >= LONG * furthest]  # lines of others are wide
    rows = [w.alike for w in ways]
    if not rows:
        return None
    step = min(float(r.time_s[1] - r.time_s[0]) for r in rows)
    found = spectrum_of(rows, HIGHEST / step)
    if found is None or not found.told.any():
        return None
    k = int(np.argmax(np.where(found.told, found.power, 0.0)))
    among = found.told & ~_overtones(found.f, float(found.f[k]), 4.0 * found.cell)
    if not found.alone(k, found.power, among, far):
        return None
    plainest = max(rows, key=lambda r: float(r.power(found.f[k])) * r.values.size)
    periods = summit(plainest, float(found.f[k]))
    if not (_goes_on(rows, periods) and _rise_as_they_fall(ways, periods)):
        return None
    chance = min(float(found.chance[k]) * found.f.size, 1.0)
    return 1.0 / periods, 1e3 * float(np.sqrt(0.5 * found.power[k])), chance


def _goes_on(rows: Sequence[Row], periods: float) -> bool:
    """Whether a line is all over the travel, in one phase: a lump or two have a line of their own
    somewhere, which ends where they do.
    """
    together, apart = 0.0, 0.0
    for row in rows:
        parts = [
            Row(x, y, 1.0).line(periods)
            for x, y in zip(np.array_split(row.time_s, PARTS), np.array_split(row.values, PARTS),
                            strict=True)
        ]  # fmt: skip
        together += abs(sum(parts)) ** 2
        apart += PARTS * sum(abs(line) ** 2 for line in parts)
    return together > AGREE * apart


def _overtones(f: FloatArray, of: float, width: float) -> NDArray[np.bool_]:
    near = np.zeros(f.size, bool)
    for order in ORDERS:
        near |= np.abs(f - order * of) <= width
    return near


def _rows(
    group: Group, model: Model, over: Callable[[Group, FloatArray], FloatArray], least: float
) -> list[_Ways]:
    """What a model leaves of every block's mean over displacement or drive, in steps of that."""
    predicted = group.predicted(model)
    left = group.measured_um.mean(axis=0) - predicted
    along, rows = over(group, predicted), []
    for a, b in group.blocks:
        x, y = along[a:b], left[a:b]
        steps = int(min(np.ptp(x) / least, (b - a) / SAMPLES))
        if steps < FEWEST:
            continue
        step = float(np.ptp(x)) / steps
        at = np.minimum(((x - x.min()) / step).astype(int), steps - 1)
        up = np.gradient(x) > 0.0
        both = [_averages(at[way], y[way], steps) for way in (up, ~up) if way.any()]
        both = [means for means in both if np.mean(np.isfinite(means)) > FILLED]
        if both:
            rows.append(_Ways.of(np.asarray(step * np.arange(steps), dtype=np.float64), both))
    return rows


@dataclass(frozen=True, eq=False)
class _Ways:
    """Of one block, over the steps: what rising and falling have alike, and half of what they
    differ by, if there are both.
    """

    alike: Row
    unlike: Row | None

    @classmethod
    def of(cls, at: FloatArray, both: Sequence[FloatArray]) -> _Ways:
        known = np.array([np.isfinite(m) for m in both])
        count = known.sum(axis=0)
        there = count > 0
        mean = np.where(known, both, 0.0).sum(axis=0)[there] / count[there]
        alike = Row(at, np.asarray(np.interp(at, at[there], mean)), 1.0)
        if len(both) < 2:
            return cls(alike, None)
        up, down = (np.interp(at, at[k], m[k]) for m, k in zip(both, known, strict=True))
        return cls(alike, Row(at, np.asarray(0.5 * (up - down)), 1.0))


def _rise_as_they_fall(ways: Sequence[_Ways], periods: float) -> bool:
    """Whether a line is much the same on both ways, in all blocks together.

    Kinks of an actuator's sliders that are evenly far apart come back with the drive as well, on
    the way down at other volts, or with the other sign.
    """
    pairs = [(w.alike, w.unlike) for w in ways if w.unlike is not None]
    alike = sum(abs(row.line(periods)) ** 2 for row, _ in pairs)
    unlike = sum(abs(row.line(periods)) ** 2 for _, row in pairs)
    return unlike <= UNLIKE * alike


def _averages(at: NDArray[np.int_], values: FloatArray, steps: int) -> FloatArray:
    """Of the values in every step; nan where there are none."""
    count = np.bincount(at, minlength=steps)
    total = np.bincount(at, values, minlength=steps)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))
