"""Constrained least squares on all samples.

Given break points, the displacement is linear in the compliances; laws and,
for clean data, the break points themselves follow by Gauss-Newton from there.
The number of elements is what predicts held-out data best, unless it is given.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Stage, dead_band
from piezo_rig.chain.half_loops import REACH, noise
from piezo_rig.errors import InputError
from piezo_rig.identification.breakpoints import BreakPoints, equal_travel, equal_volts, read_off
from piezo_rig.identification.curves import Curves
from piezo_rig.identification.data import Data
from piezo_rig.identification.folds import Folds
from piezo_rig.identification.normal import (
    Normal,
    Piece,
    finer,
    normal_equations,
    pieces_of,
    residuals,
    rms,
)
from piezo_rig.identification.polish import polish
from piezo_rig.identification.smooth import Prior
from piezo_rig.identification.solve import FLOOR, fill_unseen, solve_smooth, untold
from piezo_rig.identification.tied import FINE_PIECES, beginnings, tied_linear, tied_with_laws
from piezo_rig.identification.uncertainty import linearised

FloatArray = NDArray[np.float64]
FINE = 80  # bands from which coarser grids are summed
COARSE = 20  # bands with which laws are looked for
COARSER = (80, 40, 20, 16, 10, 8, 5)
WORSE = 1.001  # a coarser grid may predict this much worse than the best
THESIS_ELEMENTS = 40
ALMOST = 0.999  # equal displacements must fit better by this, or equal drives are kept
CLEAN = 3e-6  # noise below this share of the travel: break points can be read off
READ_OFF = 1e-5  # of the travel: what data without noise leave, written with few digits
EXACT = 1e-3  # of the rms on a grid: break points that were read off are the true ones
ROUNDING = 1e-11  # of the travel: the error of a fit that is exact but for rounding
ALIKE = 0.02  # regressors that vary less, relative to their size, do not vary
Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """A fit before it becomes a model.

    ``others``: fits as good as ``curves`` that differ between the points of data without noise;
    ``normal``: the equations about the fit by pieces of pieces, where they were made already.
    """

    curves: Curves
    pieces: tuple[Piece, ...]
    folds: Folds
    notes: tuple[str, ...]
    prior: Prior | None = None
    others: tuple[Curves, ...] = ()
    normal: Normal | None = None


def fit(
    data: Data,
    one_curve: bool,
    laws: tuple[type[Stage], ...],
    elements: int | None,
    progress: Progress,
) -> LeastSquares:
    """Fit one or two curves and the laws of the first spring; see the module.

    Noisy data get tied elements (`tied`) unless their number is given.
    """
    folds = Folds.of(data)
    pieces = pieces_of(data, cycles=folds.kind == "cycles")
    notes: list[str] = []
    if not one_curve and not data.has_first_rise:
        notes.append("no first rise from rest in the data: the initiation curve is taken as the "
                     "later branch at half its size")  # fmt: skip
    notes += [folds.warning] if folds.warning else []
    progress("elements", 0.1)
    sigma = max(dead_band(t.displacement_um) for t in data.tracks) / REACH
    rough = max(noise(t.displacement_um) for t in data.tracks)  # noise, or a drive of few samples
    clean, smooth = (x < CLEAN * data.travel_um for x in (sigma, rough))
    few = data.one_repeat()  # what is looked for by trial is looked for there
    few_pieces = pieces if few is data else pieces_of(few, cycles=folds.kind == "cycles")
    if elements is None and not clean:
        return _many(data, one_curve, laws, pieces, folds, few, notes)
    begun = list(notes)
    if elements is None:
        spaced = [_chosen(data, one_curve, pieces, folds, notes)]
        if laws and data.has_first_rise:
            # a law acts up to the first break, so the thesis's own spacing is tried as well
            spaced.append(_at_equal_travel(data, one_curve, pieces, THESIS_ELEMENTS))
    else:
        spaced = _given(data, one_curve, pieces, elements)
    progress("curves", 0.4)
    fitted = [_fit_laws(few, c, laws, few_pieces) for c in spaced]
    errors = [rms(few, residuals(few, c)) for c in fitted]
    curves = fitted[-1] if errors[-1] < ALMOST * errors[0] else fitted[0]
    if laws and few is not data:
        curves, _ = polish(data, curves, pieces, knots=False)
    if len(fitted) > 1:
        notes.append(
            f"elements at equal steps of {'displacement' if curves is fitted[1] else 'drive'} "
            f"(rms {1e3 * min(errors):.3g} against {1e3 * max(errors):.3g} nm)"
        )
    progress("law", 0.6)
    others: tuple[Curves, ...] = ()
    if clean:
        curves, others = _clean(data, curves, pieces, sigma, bool(folds.warning), notes)
        exact = rms(data, residuals(data, curves)) < READ_OFF * data.travel_um
        if elements is None and not smooth and not exact:
            return _many(data, one_curve, laws, pieces, folds, few, begun)
    missing = untold(linearised(data, curves, pieces).gram.sum(axis=0)).shape[1]
    if missing:
        notes.append(
            f"warning: the data cannot tell {missing} of the elements from their neighbours "
            "(the drive never stops between): there they go on as the neighbours do"
        )
    progress("curves", 0.8)
    return LeastSquares(curves, pieces, folds, tuple(notes), None, others)


def _many(
    data: Data, one_curve: bool, laws: tuple[type[Stage], ...], pieces: tuple[Piece, ...],
    folds: Folds, few: Data, notes: list[str],
) -> LeastSquares:
    """Many tied elements, and a note that says so."""
    curves, prior, fine = _tied(data, one_curve, laws, pieces, folds, few)
    if fine is None:
        fine = linearised(data, curves, finer(data, pieces, FINE_PIECES)[0])
    gram = fine.gram.sum(axis=0)
    sizes = (curves.first_c.size, curves.later_c.size)[: 1 if one_curve else 2]
    notes.append(
        f"{' and '.join(map(str, sizes))} elements tied to their neighbours, as good as "
        f"{prior.effective(gram):.0f} free ones (marginal likelihood, held-out {folds.kind})"
    )
    return LeastSquares(curves, pieces, folds, tuple(notes), prior, normal=fine)


def _tied(
    data: Data,
    one_curve: bool,
    laws: tuple[type[Stage], ...],
    pieces: tuple[Piece, ...],
    folds: Folds,
    few: Data,
) -> tuple[Curves, Prior, Normal | None]:
    """Curves of many tied elements, with the laws fitted; the normal equations without laws.

    ``few``: one repeat, on which the first break is looked for.
    """
    first_reach, later_reach = _reaches(data)
    reach = max(first_reach, later_reach / 2.0)
    grid = equal_volts(reach if one_curve else first_reach, FINE)
    start = _start(data, one_curve, grid, equal_volts(later_reach, FINE))
    x, prior, fine = tied_linear(data, start, pieces, folds, floor_of(data))
    curves = with_compliances(start, x, data.has_first_rise)
    if not laws:
        return curves, prior, _about(fine, curves) if curves.shared else None
    few = beginnings(few)
    few_pieces = pieces_of(few, cycles=folds.kind == "cycles")
    grids = (equal_volts(reach, COARSE) for reach in (first_reach, later_reach))
    coarse, _ = linear(few, _start(data, False, *grids), few_pieces)
    begun = _fit_laws(few, coarse, laws, few_pieces)
    return *tied_with_laws(data, few, curves, begun, prior, folds, pieces, few_pieces), None


def _about(normal: Normal, curves: Curves) -> Normal:
    """Linear equations with the sums of squares that are left at a fit."""
    x = curves.pack(False)
    left = normal.power - 2.0 * normal.right @ x + (normal.gram @ x) @ x
    return replace(normal, power=np.maximum(left, 0.0))


def _fit_laws(
    data: Data, curves: Curves, laws: tuple[type[Stage], ...], pieces: tuple[Piece, ...]
) -> Curves:
    """The curves with the laws of the first spring fitted; the curves alone without laws."""
    curves = replace(curves, laws=tuple(_neutral(law) for law in laws))
    if laws:
        if curves.later_c.size < 3:
            raise InputError(
                "too-few-elements",
                f"a law of the first spring needs three later elements, not {curves.later_c.size}",
                "too few elements were asked for, or the drive hardly moves",
                "ask for more elements, or identify `initiation`",
            )
        _check_laws(data, curves)
        curves = _with_laws(data, curves, pieces)
    return curves


def _neutral(kind: type[Stage]) -> Stage:
    return kind.of(None, **{n: kind.neutral.get(n, 0.0) for n in kind.units})


def _check_laws(data: Data, curves: Curves) -> None:
    """Refuse a law when all half loops have the same history."""
    used = []
    for track in data.tracks:
        start = track.loops.start
        inside = np.any([(start >= max(a, 1)) & (start < b) for a, b in track.blocks], axis=0)
        used.append(curves.law_derivatives(track.loops)[inside, 1:])
    columns = np.concatenate(used)
    for k, (i, name) in enumerate(curves.law_names):
        column = columns[:, k]
        if np.std(column) < ALIKE * np.max(np.abs(column)):
            raise InputError(
                "law-not-determined",
                f"{curves.laws[i].id}: its {name} cannot be told: the half loops ({column.size}) "
                "have nearly the same history",
                "one condition cannot show how the first spring depends on history",
                "give recordings of several ranges, or identify `initiation` or `classical`",
            )


def _with_laws(data: Data, curves: Curves, pieces: tuple[Piece, ...]) -> Curves:
    """The laws fitted, with the first break where it fits best.

    The law holds up to the first break, so where that lies matters: bands of the grid are
    joined to the first one as long as the fit gains by it.
    """
    best, error = polish(data, curves, pieces, knots=False, steps=6, enough=1e-3)
    worse = 2 if curves.dx_um else 0
    joined = 1
    while worse < 2 and curves.later_c.size - joined >= 3:
        width = np.diff(curves.later_knots[: joined + 1], prepend=0.0)
        mean = float(np.sum(width * curves.later_c[: joined + 1]) / np.sum(width))
        start = replace(
            curves,
            later_knots=curves.later_knots[joined:],
            later_c=np.concatenate([[mean], curves.later_c[joined + 1 :]]),
        )
        joined += 1
        trial, value = polish(data, start, pieces, knots=False, steps=6, enough=1e-3)
        if value < error:
            best, error, worse = trial, value, 0
        else:
            worse += 1
    return polish(data, best, pieces, knots=False)[0]


# -- linear fits at given break points


def linear(data: Data, curves: Curves, pieces: tuple[Piece, ...]) -> tuple[Curves, Normal]:
    """Compliances at the break points of ``curves`` (no laws)."""
    normal = normal_equations(data, curves, pieces)
    gram, right = normal.gram.sum(axis=0), normal.right.sum(axis=0)
    x = solve_smooth(gram, right, curves.bounded(False), floor_of(data), curves.runs())
    return with_compliances(curves, x, data.has_first_rise), normal


def floor_of(data: Data) -> float:
    """Smallest compliance that a fit may give, um/V."""
    return FLOOR * data.travel_um / max(data.first_reach_v, data.later_reach_v)


def with_compliances(curves: Curves, x: FloatArray, first_rise: bool) -> Curves:
    """Fitted compliances put in; bands that were never visited go on with their neighbour's."""
    if curves.shared:
        return curves.unpack(fill_unseen(x), False)
    n0 = curves.first_c.size
    later = fill_unseen(x[n0:])
    out = replace(curves, later_c=later)
    if first_rise:
        return replace(out, first_c=fill_unseen(x[:n0]))
    return replace(out, first_knots=out.later_knots / 2.0, first_c=later)


def _start(data: Data, one_curve: bool, first: FloatArray, later: FloatArray) -> Curves:
    c = data.travel_um / max(data.first_reach_v, data.later_reach_v)
    if one_curve:
        later = 2.0 * first
    ones = [np.full(k.size + 1, c) for k in (first, later)]
    return Curves(first, ones[0], later, ones[1], one_curve)


def _reaches(data: Data) -> tuple[float, float]:
    """Reach of the first rise and of a later branch; both over ground that data cover."""
    later = data.later_reach_v
    return (data.first_reach_v or later / 2.0), later


def _given(data: Data, one_curve: bool, pieces: tuple[Piece, ...], n: int) -> list[Curves]:
    """n elements, at equal steps of drive and at equal steps of displacement."""
    if n < 1 or n > 500:
        raise InputError("elements", f"{n} elements", "", "use 1 to 500 elements")
    first_reach, later_reach = _reaches(data)
    reach = max(first_reach, later_reach / 2.0)
    step = reach / n
    first = step * np.arange(1.0, int(np.ceil(first_reach / step - 1e-9)))
    later = 2.0 * step * np.arange(1.0, int(np.ceil(later_reach / (2.0 * step) - 1e-9)))
    first = equal_volts(reach, n) if one_curve else first
    volts, _ = linear(data, _start(data, one_curve, first, later), pieces)
    return [volts, _at_equal_travel(data, one_curve, pieces, n)]


def _at_equal_travel(data: Data, one_curve: bool, pieces: tuple[Piece, ...], n: int) -> Curves:
    """n elements that give way at multiples of one displacement, which is fitted too."""
    first_reach, later_reach = _reaches(data)
    reach = max(first_reach, later_reach / 2.0)
    dense = equal_volts(reach if one_curve else first_reach, FINE)
    fine, _ = linear(data, _start(data, one_curve, dense, equal_volts(later_reach, FINE)), pieces)
    dx = _travel(fine, first_reach if data.has_first_rise else reach) / n
    first = equal_travel(fine.first_knots, fine.first_c, reach if one_curve else first_reach, dx)
    later = equal_travel(fine.later_knots, fine.later_c, later_reach, 2.0 * dx)
    equal, _ = linear(data, _start(data, one_curve, first, later), pieces)
    if data.has_first_rise:
        equal = replace(equal, dx_um=dx)
        equal = equal.unpack(equal.pack(False), False)  # its break points at multiples of dx
        equal, _ = polish(data, equal, pieces, knots=False, steps=8, enough=1e-4)
    return equal


def _travel(curves: Curves, reach: float) -> float:
    knots = np.concatenate([[0.0], curves.first_knots[curves.first_knots < reach], [reach]])
    return float(np.sum(np.diff(knots) * curves.first_c[: knots.size - 1]))


def _chosen(
    data: Data, one_curve: bool, pieces: tuple[Piece, ...], folds: Folds, notes: list[str]
) -> Curves:
    """The smallest number of elements that predicts held-out data (nearly) best."""
    first_reach, later_reach = _reaches(data)
    reach = max(first_reach, later_reach / 2.0)
    fine = _start(
        data, one_curve, equal_volts(reach if one_curve else first_reach, FINE),
        equal_volts(later_reach, FINE),
    )  # fmt: skip
    normal = normal_equations(data, fine, pieces)
    floor = floor_of(data)

    def score(sizes: tuple[int, ...]) -> float:
        matrix = _summing(sizes)
        small = normal.reduced(matrix)
        bounded = np.ones(matrix.shape[1], bool)
        return folds.held_out_power(small, bounded, floor, sizes)

    gram = normal.gram.sum(axis=0)

    def told(sizes: tuple[int, ...]) -> bool:
        matrix = _summing(sizes)
        return untold(matrix.T @ gram @ matrix).shape[1] == 0

    alike = {n: (n,) if one_curve else (n, n) for n in COARSER}
    told_apart = [n for n in COARSER if told(alike[n])] or [COARSER[-1]]
    best = {n: score(alike[n]) for n in told_apart}
    least = min(best.values())
    n = min(k for k, v in best.items() if v <= least * WORSE**2)
    sizes: tuple[int, ...] = (n,) if one_curve else (n, n)
    if not one_curve and data.has_first_rise:
        firsts = {k: score((k, n)) for k in COARSER if k == n or told((k, n))}
        least = min(firsts.values())
        sizes = (min(k for k, v in firsts.items() if v <= least * WORSE**2), n)
    notes.append(
        f"{' and '.join(map(str, sizes))} elements, chosen by held-out {folds.kind}: "
        + ", ".join(f"{k}: {1e3 * np.sqrt(v):.3g} nm" for k, v in sorted(best.items()))
    )
    grid = equal_volts(reach if one_curve else first_reach, sizes[0])
    curves, _ = linear(
        data, _start(data, one_curve, grid, equal_volts(later_reach, sizes[-1])), pieces
    )
    return curves


def _summing(sizes: tuple[int, ...]) -> FloatArray:
    """Matrix that gives every fine band the compliance of the coarse one it lies in."""
    out = np.zeros((FINE * len(sizes), sum(sizes)))
    column = 0
    for i, n in enumerate(sizes):
        for j in range(FINE):
            out[i * FINE + j, column + j * n // FINE] = 1.0
        column += n
    return out


# -- data without noise


def _clean(
    data: Data, curves: Curves, pieces: tuple[Piece, ...], sigma: float, sparse: bool,
    notes: list[str],
) -> tuple[Curves, tuple[Curves, ...]]:
    """Break points moved to where clean data have them; kept only if that is a different class.

    Returns also fits that are as good: where few levels of drive (``sparse``) or few points on a
    line leave it open what happens between points.
    """
    before = rms(data, residuals(data, curves))
    starts = []
    kind = "one" if curves.shared else "law" if curves.laws else "two"
    points = read_off(data, sigma, kind)
    read = _from_read(data, curves, points)
    starts += [read] if read is not None else []
    starts.append(replace(curves, dx_um=0.0))
    best, error = curves, before
    for start in starts:
        try:
            moved, _ = polish(data, start, pieces, knots=False, steps=6)
            moved, value = polish(data, moved, pieces, knots=True, steps=15, enough=0.02)
        except (InputError, np.linalg.LinAlgError):
            continue
        if value < error:
            best, error = moved, value
        if error < max(EXACT * before, ROUNDING * data.travel_um):
            break
    by_reading = best is not curves and start is read
    if error < 0.2 * before or (by_reading and error < ROUNDING * data.travel_um):
        notes.append(
            f"the data carry no noise: break points follow them ({best.first_c.size} and "
            f"{best.later_c.size} pieces), rms from {1e3 * before:.3g} to {1e3 * error:.3g} nm"
        )
        others: tuple[Curves, ...] = ()
        if by_reading and (sparse or not points.sure) and not curves.laws:
            other = _from_read(data, curves, read_off(data, sigma, kind, straight=True))
            others = (other,) if other is not None else ()
            notes.append(
                "warning: there may be more break points between samples than the data tell "
                "(the bands say how much that matters)"
            )
        return best, others
    return curves, ()


def _from_read(data: Data, curves: Curves, points: BreakPoints) -> Curves | None:
    laws = curves.laws
    first, later = points.first, points.later
    if not later.size or (data.has_first_rise and not first.size):
        return None
    if curves.shared or not data.has_first_rise:
        first = later / 2.0
    if first.size > 200 or later.size > 200 or (laws and later.size < 2):
        return None
    start = _start(data, curves.shared, first, later)
    fitted, _ = linear(data, start, pieces_of(data))
    return replace(fitted, laws=laws)
