"""The thesis's identification: slopes of segments of equal displacement (eq. 12-24).

Half loops are cut into segments, dx on the first rise and 2 dx on later half
loops; the drive is fitted as a line over the displacement in each; slopes are
averaged element by element over all tests; springs follow from the slopes.
The first spring of every half loop is what remains of its first slope, and is
fitted against the input range or the local extremum.

Set right against the published code (it is a description, not a source): every
first spring is paired with the half loop that it came from; each element is
averaged over the tests that reach it; a segment counts only when the half loop
crosses all of it; break points are those of the half loop at hand; one dx
serves all repeats. The first and last cycle of a condition are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Elements, Stage
from piezo_rig.errors import InputError
from piezo_rig.identification.data import Data

FloatArray = NDArray[np.float64]
SAME = 0.02  # half loops whose ranges differ by less belong to one condition
WHOLE = 0.9  # share of a segment that a half loop must cross


@dataclass(frozen=True, eq=False)
class HalfLoopSlopes:
    """One half loop's segment slopes and what its first spring may depend on."""

    slopes: FloatArray
    range_v: float
    extremum_v: float
    direction: float
    sweep: int


@dataclass(frozen=True, eq=False)
class FirstSprings:
    """First springs paired with their half loops; all shape (m,). See `r_squared`."""

    k1: FloatArray
    range_v: FloatArray
    extremum_v: FloatArray
    direction: FloatArray


@dataclass(frozen=True, eq=False)
class Slopes:
    """Outcome of the slope scheme.

    Attributes
    ----------
    dx_um : the step of displacement
    first, later : elements of the first rise and of later half loops
    laws : the law stages, fitted
    first_springs : k1 of every half loop that was used
    r_squared : law id -> share of the variance of k1 that the law explains
    notes : what was left out
    """

    dx_um: float
    first: Elements
    later: Elements
    laws: tuple[Stage, ...]
    first_springs: FirstSprings
    r_squared: dict[str, float]
    notes: tuple[str, ...]


def fit_slopes(data: Data, one_curve: bool, laws: tuple[type[Stage], ...], elements: int) -> Slopes:
    """The slope scheme with ``elements`` steps of dx over the largest first rise.

    Raises
    ------
    InputError : no half loop crosses a whole segment
    """
    notes: list[str] = []
    dx = _travel(data) / elements
    first = _first_rise(data, dx)
    used, left = _later(data, dx)
    notes.append(f"{left} half loops of first and last cycles left out, {len(used)} used")
    if not used:
        raise InputError(
            "too-few-half-loops",
            f"no half loop after the first rise crosses a segment of {2 * dx:.3g} um",
            "too few cycles, too little travel, or too few elements",
            "record more cycles, or ask for more elements",
        )
    later = _average([h.slopes for h in used])
    if one_curve:
        both = [h.slopes for h in used] + ([first] if first is not None else [])
        slopes = _average(both)
        table = Elements.from_slopes(slopes, dx * np.arange(1.0, slopes.size + 1))
        return Slopes(dx, table, table, (), _first_springs(used, later), {}, tuple(notes))
    if first is None:
        notes.append("no first rise from rest in the data: the initiation curve is that of "
                     "later half loops")  # fmt: skip
        first = later
    springs = _first_springs(used, later)
    stages, r_squared = _fit_laws(laws, springs, later)
    table = Elements.from_slopes(later, dx * np.arange(1.0, later.size + 1))
    if any("offset" in s.units for s in stages):
        k = table.k_v_per_um.copy()
        k[0] = 0.0
        table = Elements(k, table.slides_at_um)
    rise = Elements.from_slopes(first, dx * np.arange(1.0, first.size + 1))
    return Slopes(dx, rise, table, stages, springs, r_squared, tuple(notes))


def r_squared(x: FloatArray, y: FloatArray) -> float:
    """Share of the variance of y that a line over x explains."""
    if np.ptp(x) == 0 or np.ptp(y) == 0:
        return 0.0
    return float(np.corrcoef(x, y)[0, 1] ** 2)


def _travel(data: Data) -> float:
    """Travel of the largest first rise, or of the largest half loop without one."""
    best = 0.0
    for t in data.tracks:
        for k, (start, stop) in enumerate(zip(t.loops.start, t.loops.stop, strict=True)):
            if (k == 0) == data.has_first_rise and (t.virgin or not data.has_first_rise):
                best = max(best, abs(t.displacement_um[stop] - t.displacement_um[start]))
    return float(best)


def _segments(x: FloatArray, v: FloatArray, step: float) -> FloatArray:
    """Slope of v over x in every segment of ``step`` that is crossed, NaN where too short."""
    count = int(np.ceil(x.max() / step * (1 - 1e-9)))
    index = np.minimum((x / step * (1 + 1e-12)).astype(int), count - 1)
    out = np.full(count, np.nan)
    for i in range(count):
        inside = index == i
        if np.count_nonzero(inside) < 2:
            continue
        xi, vi = x[inside], v[inside]
        if np.ptp(xi) < min(WHOLE * step, 0.3 * step if i == count - 1 and count > 8 else step):
            if i < count - 1:
                # few samples to a segment: they cannot span it
                if np.count_nonzero(inside) < 3:
                    continue
            else:
                continue
        centred = xi - xi.mean()
        power = float(centred @ centred)
        if power > 0:
            out[i] = float(centred @ (vi - vi.mean())) / power
    return out


def _first_rise(data: Data, dx: float) -> FloatArray | None:
    """Slopes of all first rises taken together (eq. 12)."""
    xs, vs = [], []
    for t in data.tracks:
        if t.virgin:
            stop = int(t.loops.stop[0])
            xs.append(np.abs(t.displacement_um[: stop + 1] - t.displacement_um[0]))
            vs.append(np.abs(t.drive_v[: stop + 1] - t.drive_v[0]))
    if not xs:
        return None
    return _cut(_segments(np.concatenate(xs), np.concatenate(vs), dx))


def _later(data: Data, dx: float) -> tuple[list[HalfLoopSlopes], int]:
    used: list[HalfLoopSlopes] = []
    left = 0
    for t in data.tracks:
        loops = t.loops
        span = np.abs(t.drive_v[loops.stop] - t.drive_v[loops.start])
        known = np.array(
            [any(a <= i and j < b for a, b in t.blocks) for i, j in zip(loops.start, loops.stop,
                                                                        strict=True)]
        )  # fmt: skip
        known[0] = False
        for group in _conditions(span, loops.range_v):
            inner = group[2:-2] if len(group) >= 6 else group
            inner = [i for i in inner if known[i]]
            left += len(group) - len(inner)
            for i in inner:
                a, b = int(loops.start[i]), int(loops.stop[i])
                x = np.abs(t.displacement_um[a : b + 1] - t.displacement_um[a])
                v = np.abs(t.drive_v[a : b + 1] - t.drive_v[a])
                slopes = _cut(_segments(x, v, 2.0 * dx))
                if slopes.size:
                    sweep = t.sweeps[int(np.searchsorted(t.edges, a, side="right")) - 1]
                    used.append(
                        HalfLoopSlopes(
                            slopes, float(loops.range_v[i]), float(loops.extremum_v[i]),
                            float(loops.direction[i]), sweep,
                        )
                    )  # fmt: skip
                else:
                    left += 1
    return used, left


def _conditions(span: FloatArray, before: FloatArray) -> list[list[int]]:
    """Runs of half loops of one range; the first rise opens the first of them."""
    groups: list[list[int]] = [[0]]
    for i in range(1, span.size):
        if abs(span[i] - span[i - 1]) <= SAME * max(span[i], span[i - 1]):
            groups[-1].append(i)
        else:
            groups.append([i])
    return groups


def _cut(slopes: FloatArray) -> FloatArray:
    """Up to the first segment without a slope."""
    bad = ~np.isfinite(slopes)
    return slopes[: int(np.argmax(bad))] if np.any(bad) else slopes


def _average(all_slopes: list[FloatArray]) -> FloatArray:
    """Each element's slope, averaged over the tests that reach it (eq. 16)."""
    n = max(s.size for s in all_slopes)
    table = np.full((len(all_slopes), n), np.nan)
    for row, s in zip(table, all_slopes, strict=True):
        row[: s.size] = s
    return np.nanmean(table, axis=0)


def _first_springs(used: list[HalfLoopSlopes], later: FloatArray) -> FirstSprings:
    second = later[1] if later.size > 1 else 0.0
    return FirstSprings(
        np.array([h.slopes[0] - second for h in used]),
        np.array([h.range_v for h in used]),
        np.array([h.extremum_v for h in used]),
        np.array([h.direction for h in used]),
    )


def _fit_laws(
    laws: tuple[type[Stage], ...], springs: FirstSprings, later: FloatArray
) -> tuple[tuple[Stage, ...], dict[str, float]]:
    """Lines of k1 over what each law names (eq. 18, 23), together where there are several."""
    regressors = {"range-dependence": springs.range_v, "extremum-dependence": springs.extremum_v}
    linear = [law for law in laws if law.id in regressors]
    stages: dict[str, Stage] = {}
    quality: dict[str, float] = {}
    if linear:
        matrix = np.stack([*(regressors[law.id] for law in linear), np.ones(springs.k1.size)], 1)
        if np.linalg.matrix_rank(matrix) < matrix.shape[1]:
            raise InputError(
                "law-not-determined",
                f"{' and '.join(law.id for law in linear)}: all half loops have the same history",
                "one condition cannot show a dependence on history",
                "give recordings of several ranges",
            )
        solution, *_ = np.linalg.lstsq(matrix, springs.k1, rcond=None)
        for i, law in enumerate(linear):
            offset = float(solution[-1]) if i == 0 else 0.0
            stages[law.id] = law.of(slope=float(solution[i]), offset=offset)
            quality[law.id] = r_squared(regressors[law.id], springs.k1)
    second = later[1] if later.size > 1 else 0.0
    for law in laws:
        if law.id == "direction-asymmetry":
            up, down = springs.k1[springs.direction > 0], springs.k1[springs.direction < 0]
            if not up.size or not down.size:
                raise InputError("law-not-determined", "half loops of one direction only",
                                 "the drive turns too seldom", "give a recording of whole cycles")
            stages[law.id] = law.of(ratio=float((up.mean() + second) / (down.mean() + second)))
            quality[law.id] = r_squared(springs.direction, springs.k1)
    return tuple(stages[law.id] for law in laws), quality
