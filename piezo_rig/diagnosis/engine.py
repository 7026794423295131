"""From groups to a ladder: noise, space, baseline, climb."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.chain.bend import Bend
from piezo_rig.diagnosis import dictionary
from piezo_rig.diagnosis.dictionary import Scales
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.grouping import FEW
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.linear import Piece
from piezo_rig.diagnosis.noise import Spectrum, Whitener, spectrum_of
from piezo_rig.diagnosis.refit import Fitted, refit
from piezo_rig.diagnosis.ripples import left_of
from piezo_rig.diagnosis.scan import candidates
from piezo_rig.diagnosis.space import Space
from piezo_rig.diagnosis.whitening import CellWhitener

FloatArray = NDArray[np.float64]
ROUNDS = 3
BENT = 0.7  # squared error with a bend, of that without it, from which on the base has one
HIDDEN = np.log(0.3)  # of the noise, that a generous model must leave to show it
ROUNDING = 1e-12  # of their size: columns that vary less are constant
EXACT = 1e-5


def scales_of(groups: Groups) -> Scales:
    """What dictionary columns are scaled by."""
    low = min(float(g.drive_v.min()) for g in groups.groups)
    high = max(float(g.drive_v.max()) for g in groups.groups)
    slews = []
    for g in groups.groups:
        seconds = np.maximum(g.time_s[g.loops.stop] - g.time_s[g.loops.start], 1e-9)
        slews.append(np.abs(g.drive_v[g.loops.stop] - g.drive_v[g.loops.start]) / seconds)
    bottoms = [float(g.measured_um.mean(axis=0).min()) for g in groups.groups]
    tops = [float(g.measured_um.mean(axis=0).max()) for g in groups.groups]
    return Scales(
        low,
        max(high - low, 1e-12),
        max(max(tops) - min(bottoms), 1e-12),
        min(bottoms),
        max(float(np.median(np.concatenate(slews))), 1e-9),
        1.0 / groups.rate,
        max(float(g.time_s[-1] - g.time_s[0]) for g in groups.groups),
    )


def pieces_of(groups: Groups) -> tuple[tuple[Piece, ...], str]:
    """Pieces, and what of the drive is held out together: conditions, else sweeps, else cycles.

    Where every drive was recorded more than once, errors are reported for recordings that were
    left out (`held_out.REPEATS`); these folds then only judge whether a model carries over.
    """
    conditions = sorted({g.condition for g in groups.groups})
    if len(groups.groups) > 1:
        named = len(conditions) >= 3
        pieces = [
            piece for i, g in enumerate(groups.groups)
            for piece in _blocks(groups, i, conditions.index(g.condition) if named else i)
        ]  # fmt: skip
        return tuple(pieces), "condition" if named else "sweep"
    cut = last_third(groups)
    if cut is None:
        return tuple(_blocks(groups, 0, 0)), "none"
    pieces = []
    for whole in _blocks(groups, 0, 0):
        n = len(whole.cells.marks)
        at = int(np.clip((cut - whole.first) // groups.factor, 0, n))
        for fold, (i, j) in enumerate([(0, at), (at, n)]):
            if j - i >= 16:
                begin, end = (whole.begin + int(whole.cells.begins[k]) for k in (i, j))
                first = whole.first + i * groups.factor
                pieces.append(Piece(0, begin, end, fold, first, whole.cells.part(i, j)))
    return tuple(pieces), "cycles"


def _blocks(groups: Groups, index: int, fold: int) -> list[Piece]:
    """The blocks of one group."""
    group = groups.groups[index]
    parts = zip(groups.edges(group), group.blocks, groups.cells(group), strict=True)
    return [Piece(index, a, b, fold, first, cells) for (a, b), (first, _), cells in parts]


def last_third(groups: Groups) -> int | None:
    """First sample of the last third of the cycles of the only group; None with too few."""
    (group,) = groups.groups
    begin = group.blocks[0][0]
    turns = group.loops.start[group.loops.start >= max(begin, 1)]
    cycles = turns.size // 2
    if cycles < 3:
        return None
    return int(turns[2 * (cycles - max(1, cycles // 3))])


def noise_of(
    groups: Groups, point: Point, rng: np.random.Generator
) -> tuple[CellWhitener, bool]:
    """What makes the noise white, and whether repeats show it; else what a generous model leaves.

    ``point`` : a fitted baseline
    """
    even, single = groups.evenly(), None
    averages = repeat_spectrum(even)
    repeated = averages is not None
    if averages is None:
        averages = generous_spectrum(bare_space(even), point, rng)
    if any(g.fine for g in groups.groups):
        single = repeat_spectrum(groups.whole())
        if single is None:
            single = generous_spectrum(bare_space(groups.whole(FEW)), point, rng)
    return CellWhitener(averages, single), repeated


def repeat_spectrum(groups: Groups) -> Spectrum | None:
    """Spectrum of one recording's noise at the thinned rate; None without repeats."""
    parts, freedom = [], []
    for g in groups.groups:
        if g.repeats < 2:
            continue
        mean = g.measured_um.mean(axis=0)
        share = (g.repeats - 1) / g.repeats
        for row in g.measured_um:
            off = groups.thinned(g, row - mean) / np.sqrt(share)
            parts += [off[a:b] for a, b in groups.edges(g)]
            freedom.append(share)
    return spectrum_of(parts, float(np.mean(freedom)), least_noise(groups)) if parts else None


def least_noise(groups: Groups) -> float:
    """Exact data are taken to have this noise, um^2: no sensor resolves more of its travel."""
    return (EXACT * groups.travel_um) ** 2


def generous_spectrum(space: Space, point: Point, rng: np.random.Generator) -> Spectrum:
    """Spectrum from what a generous model leaves, where there are no repeats.

    The generous model takes power of its own out of the noise, most at low frequencies; how much
    is found by sending known noise through the same projection. Of frequencies of which it takes
    nearly all, what it leaves says nothing: see `onward`.
    """
    found, _ = candidates(space, point.model)
    pairs = [pair for c in found for pair in c.pairs(point.model)]
    blocks, every = [], space.moving(point, pairs)
    for index, group in enumerate(space.groups.groups):
        moving = every[:, space.together.part(index)]
        predicted = group.predicted(point.model)
        f = dictionary.features(group, space.scales, predicted)
        fixed = np.concatenate(
            [
                dictionary.powers(group, space.scales),
                dictionary.fine(group, space.scales, False)[::3],
                dictionary.generic(group, space.scales, f)[0],
            ]
        )
        columns = np.concatenate([moving[:-1], space.groups.thinned(group, fixed)])
        for a, b in space.groups.edges(group):
            blocks.append((_centred(columns[:, a:b]), moving[-1, a:b]))
    gram = sum(x @ x.T for x, _ in blocks)
    assert not isinstance(gram, int)
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    gram = gram / np.outer(size, size) + 1e-7 * np.eye(size.size)

    def left(targets: list[FloatArray]) -> list[FloatArray]:
        targets = [t - t.mean() for t in targets]
        right = sum(x @ t for (x, _), t in zip(blocks, targets, strict=True)) / size
        beta = np.linalg.solve(gram, right) / size
        return [t - x.T @ beta for (x, _), t in zip(blocks, targets, strict=True)]

    residual = left([y for _, y in blocks])
    least = least_noise(space.groups)
    measured = spectrum_of(residual, least=least)
    white = [rng.standard_normal(y.size) for _, y in blocks]
    kept = spectrum_of(left(white))
    hidden = np.interp(np.log(measured.frequency), np.log(kept.frequency), kept.log_power) < HIDDEN
    first = int(np.flatnonzero(hidden).max(initial=-1)) + 1
    current = measured.onward(first)
    for _ in range(ROUNDS):
        filter = Whitener(current, raised=0.0)
        noise = [filter.coloured(y.size, rng) for _, y in blocks]
        seen = spectrum_of(left(noise), least=1e-6 * least)
        want = np.clip(current.log_power - seen.log_power, -0.5, 4.0)
        change = np.interp(np.log(measured.frequency), np.log(current.frequency), want)
        current = Spectrum(
            measured.frequency, measured.log_power + change, measured.error * np.sqrt(2.0)
        ).onward(first)
    return current


def _centred(columns: FloatArray) -> FloatArray:
    """Columns (k, n) less their means; of what does not change, nothing but rounding is left."""
    out = columns - columns.mean(axis=1, keepdims=True)
    still = np.ptp(columns, axis=1) <= ROUNDING * np.max(np.abs(columns), axis=1)
    out[still] = 0.0
    return np.asarray(out)


def space_of(groups: Groups, whitener: CellWhitener, model: Model) -> tuple[Space, str]:
    """A prepared space, and what is held out."""
    pieces, kind = pieces_of(groups)
    first = not model.one_curve
    space = Space(groups, pieces, whitener, scales_of(groups), first)
    space.prepare(model)
    return space, kind


def bare_space(groups: Groups) -> Space:
    """A space with white noise, not yet prepared for any model."""
    averages = Spectrum(np.array([1e-6, 0.5]), np.log([1e-6, 1e-6]), np.zeros(2))
    white = CellWhitener(averages, averages.scaled(float(groups.factor)))
    return Space(groups, pieces_of(groups)[0], white, scales_of(groups), False)


def plain_space(groups: Groups, model: Model, bare: bool = False) -> Space:
    """A space for least squares with white noise; ``bare`` : on compliances alone."""
    space = bare_space(groups)
    space.bare = bare
    space.prepare(model)
    return space


def plainly(groups: Groups, point: Point) -> Fitted:
    """A point fitted by least squares with white noise."""
    return refit(plain_space(groups, point.model, not point.sizes), point)


def with_a_bend(groups: Groups, point: Point) -> Point | None:
    """The same with a memoryless bend, fitted so; None where it has one, or is held as it is."""
    if point.fixed or point.model.stage(Bend.id) is not None:
        return None
    scales = scales_of(groups)
    bent = point.model.with_stage(Bend.none(scales.low_v, scales.span_v))
    return plainly(groups, Point(bent, (), point.sizes)).point


def with_its_bend(groups: Groups, base: Point) -> Point:
    """The same with a memoryless bend, where there is plainly one: a base that lacks it leaves more
    than lost samples and ripples are, with kinks that come back.
    """
    bent = with_a_bend(groups, base)
    if bent is not None and left_of(groups, bent.model) < BENT * left_of(groups, base.model):
        return bent
    return base
