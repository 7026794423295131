"""What a misfit may look like when nobody has a name for it.

Three sets of columns, for one group at full rate: `powers` of the drive (a memoryless bend of the
actuator is nobody's finding), `fine` play operators on a grid much finer than any model's break
points (the base model is never exact), and the `generic` dictionary, with tags that say what each
column depends on. The last is both mismatch and the rival that every named cause must beat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model, Signal, Stage
from piezo_rig.chain.stage import Wider
from piezo_rig.chain.widening import each_wider_v
from piezo_rig.diagnosis.groups import Group
from piezo_rig.diagnosis.left_before import played_before

FloatArray = NDArray[np.float64]
POWERS = (2, 3, 4, 5)
FINE = 90  # evenly spaced thresholds; six more lie below the first
SMOOTH = 8  # shapes of a smooth density
CHANGES, PLACES, RISES, EARLY = 8, 12, 6, 5


@dataclass(frozen=True)
class Scales:
    """What the columns are scaled by, the same for all groups.

    Attributes
    ----------
    low_v, span_v : lowest drive, and the range of all drives
    travel_um, bottom_um : range and lowest value of the displacement
    slew_v_per_s : typical |dV/dt|
    shortest_s, longest_s : sampling step, longest recording
    """

    low_v: float
    span_v: float
    travel_um: float
    bottom_um: float
    slew_v_per_s: float
    shortest_s: float
    longest_s: float


def powers(group: Group, scales: Scales) -> FloatArray:
    """Shape (len(POWERS), n)."""
    u = (group.drive_v - scales.low_v) / scales.span_v
    return np.array([u**p for p in POWERS])


def fine_thresholds(scales: Scales) -> tuple[FloatArray, FloatArray]:
    """Thresholds of the fine play operators and how much of each is to be expected, volts."""
    half = 0.5 * scales.span_v
    even = half * np.arange(1, FINE + 1) / FINE
    small = even[0] * np.geomspace(0.04, 0.7, 6)
    # only a first rise reaches these
    large = half + half * np.arange(1, FINE // 4) / (FINE // 4)
    r = np.concatenate([small, even, large])
    # thresholds lie anywhere: the mass in a cell varies as the root of its width
    return r, np.sqrt(np.gradient(r) * even[0])


def fine(
    group: Group, scales: Scales, first_rise: bool, model: Model | None = None,
    wider: Wider | None = None,
) -> FloatArray:
    """Play operators, weighted; with ``first_rise`` also steps of the first rise.

    ``model`` : says what they remember of the drives before; ``wider`` : by how much
    all thresholds are
    """
    r, cell = fine_thresholds(scales)
    begun = played_before(model, group) if model else [(1.0, np.empty(0))]
    plays = cell[:, None] * sum(
        share * _widened(np.concatenate([volts, group.drive_v]), r, wider)[:, volts.size :]
        for share, volts in begun
    )
    if not first_rise:
        return plays
    reach = np.maximum.accumulate(np.abs(group.drive_v - group.drive_v[0]))
    if not group.virgin:
        reach = np.zeros_like(reach)
    steps = 2.0 * r[::2, None]
    return np.concatenate([plays, np.minimum(reach, steps) * 2.0 * cell[::2, None]])


def _widened(drive_v: FloatArray, r: FloatArray, wider: Wider | None) -> FloatArray:
    """Play operators (k, n) whose thresholds are wider at the last so many samples."""
    plays = np.asarray(_plays(drive_v, r))
    if wider is None:
        return plays
    wider = wider.after(drive_v.size - wider.share.size)
    return plays + each_wider_v(r, np.zeros(1, np.int64), drive_v, wider)


def carries(stage: Stage) -> bool:
    """Whether what is before a stage shows differently behind it."""
    return type(stage).act is not Stage.act and not stage.passes


def through(model: Model, group: Group, columns: FloatArray) -> FloatArray:
    """What the sensor shows of small changes (k, n) of the actuator's own displacement."""
    stages = [
        s
        for s in model.stages
        if s.place != "drive" and s.locked_to == "drive" and carries(s)
    ]
    if not stages:
        return columns
    base = model.with_(stages=tuple(s for s in model.stages if s not in stages))
    moved = base.simulate(group.time_s, group.drive_v, group.history, since_virgin=True)

    reads = None if group.reads is None else (group.reads,)
    played = None if group.played is None else (group.played,)
    signal = Signal(group.time_s, group.drive_v, moved, reads=reads, played=played)
    for stage in stages:
        columns = stage.carry(signal, columns)
        signal = stage.act(signal)
    return columns


def smooth(plays: FloatArray, scales: Scales, first_rise: bool) -> FloatArray:
    """Smooth densities of thresholds, from the columns of `fine`; shape (SMOOTH, n) or twice that.

    A model's elements are lumps, an actuator's density is not: between the lumps it is positive
    everywhere. That difference is the same in every band and must not be taken for chance.
    """
    r, weight = fine_thresholds(scales)
    cell = np.gradient(r)
    x = r / r[-1]
    shapes = np.array([(1 - x) ** (SMOOTH - 1 - p) * x**p for p in range(SMOOTH)])
    out = (shapes * cell / weight) @ plays[: r.size]
    if not first_rise:
        return out
    steps = plays[r.size :]
    more = (shapes * cell / weight)[:, ::2] @ steps
    return np.concatenate([out, more])


@numba.njit(cache=True, nogil=True)
def _plays(v, r):
    """Play operators with thresholds r, at rest at the first sample; shape (k, n)."""
    out = np.empty((r.size, v.size))
    for j in range(r.size):
        x = v[0]
        for i in range(v.size):
            if v[i] - x > r[j]:
                x = v[i] - r[j]
            elif x - v[i] > r[j]:
                x = v[i] + r[j]
            out[j, i] = x
    return out


@dataclass(frozen=True, eq=False)
class Features:
    """Per sample: what a misfit may depend on."""

    change: FloatArray  # drive change since the turning point, of the span
    direction: FloatArray
    range: FloatArray  # of the half loop before, of the span
    extremum: FloatArray  # drive at the turning point, 0..1
    since_s: FloatArray
    cycle: FloatArray
    reach: FloatArray  # largest |drive - first drive| so far, of the span; 0 unless virgin
    on_first: FloatArray  # 1 on the first rise of a virgin group
    place: FloatArray  # displacement, 0..1
    slew: FloatArray  # mean |dV/dt| of the half loop, over the typical one


def features(group: Group, scales: Scales, predicted_um: FloatArray) -> Features:
    loops, v, n = group.loops, group.drive_v, group.drive_v.size
    index = np.clip(np.searchsorted(loops.start, np.arange(n), side="right") - 1, 0, None)
    start = loops.start[index]
    seconds = np.maximum(group.time_s[loops.stop] - group.time_s[loops.start], 1e-9)
    moved = np.abs(v[loops.stop] - v[loops.start])
    reach = np.maximum.accumulate(np.abs(v - v[0])) / scales.span_v
    change = np.abs(v - loops.extremum_v[index]) / scales.span_v
    first = (index == 0).astype(float) if group.virgin else np.zeros(n)
    return Features(
        change=change,
        direction=loops.direction[index],
        range=loops.range_v[index] / scales.span_v,
        extremum=(loops.extremum_v[index] - scales.low_v) / scales.span_v,
        since_s=group.time_s - group.time_s[start],
        cycle=((index + 1) // 2).astype(float),
        reach=reach if group.virgin else np.zeros(n),
        on_first=first,
        place=(predicted_um - scales.bottom_um) / scales.travel_um,
        slew=(moved / seconds / scales.slew_v_per_s)[index],
    )


def generic(group: Group, scales: Scales, f: Features) -> tuple[FloatArray, list[str]]:
    """The dictionary, shape (k, n) in um with a size of about 1, and what each depends on."""
    columns: list[FloatArray] = []
    tags: list[str] = []

    def add(what: str, *made: FloatArray) -> None:
        columns.extend(made)
        tags.extend([what] * len(made))

    later = 1.0 - f.on_first
    hats = hats_of(np.log(np.maximum(f.change, 1e-6)), np.log(np.geomspace(0.004, 1.0, CHANGES)))
    hats[0] *= np.clip(f.change / 0.004, 0.0, 1.0)
    for hat in hats:
        shaped = hat * later
        signed = shaped * f.direction
        add("direction", shaped)
        add("time_since_turn+direction", signed)
        add("range", shaped * f.range, signed * f.range, signed * f.range**2)
        add("range+drive", signed * f.range * f.extremum)
        add("drive+direction", shaped * f.extremum, signed * f.extremum)
    edges = np.concatenate([np.geomspace(0.008, 0.13, EARLY), np.linspace(0.25, 1.0, RISES)])
    for hat in hats_of(f.reach, edges):
        add("first rise", hat * np.clip(f.reach / edges[0], 0.0, 1.0))
    centres = np.linspace(0.0, 1.0, PLACES)
    for hat in hats_of(f.place, centres):
        add("displacement", hat)
        add("displacement+direction", hat * f.direction * np.minimum(f.change / 0.05, 1.0))
    aged = np.log1p(f.cycle)
    bend = f.place * (1.0 - f.place)
    add("cycle", aged, aged * f.place, aged * bend, aged * bend * f.direction)
    parity = np.where(f.cycle % 2 == 1, 1.0, -1.0) * later
    add("cycle", parity * bend, parity * bend * f.direction, parity * f.place)
    since = np.log10(np.maximum(f.since_s, scales.shortest_s) / scales.shortest_s)
    decades = max(np.log10(scales.longest_s / scales.shortest_s), 1.0)
    for hat in hats_of(since / decades, np.linspace(0.0, 1.0, 9)):
        turned = hat * f.direction * later
        add("time_since_turn", turned, turned * f.slew)
    speed = np.log(np.clip(f.slew, 1e-3, 1e3))
    smooth = np.minimum(f.change / 0.02, 1.0) * f.direction
    add("frequency", smooth * speed, smooth * speed**2, smooth * speed * f.place)
    clock = group.time_s / scales.longest_s
    for k in (1, 2, 3):
        add("clock", np.cos(np.pi * k * clock))
    add("clock", clock)
    moved = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(group.drive_v)))])
    add("clock", moved / max(float(moved[-1]), 1e-30))
    return np.array(columns), tags


def hats_of(x: FloatArray, at: FloatArray) -> FloatArray:
    """Piecewise linear hats with corners ``at``, constant beyond the ends; shape (k, n)."""
    return np.array([np.interp(x, at, row) for row in np.eye(at.size)])


DEPENDS = {
    "first rise": ("drive", "cycle"),
}


def depends_on(tag: str) -> tuple[str, ...]:
    """The contract's words for a tag."""
    return DEPENDS.get(tag, tuple(tag.split("+")))
