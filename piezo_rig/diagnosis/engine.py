"""From groups to a ladder: noise, space, baseline, climb."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.diagnosis import dictionary
from piezo_rig.diagnosis.dictionary import Scales
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.noise import Spectrum, Whitener, spectrum_of
from piezo_rig.diagnosis.scan import candidates
from piezo_rig.diagnosis.space import Piece, Space

FloatArray = NDArray[np.float64]
ROUNDS = 3
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
    pieces: list[Piece] = []
    if len(groups.groups) > 1:
        named = len(conditions) >= 3
        for i, g in enumerate(groups.groups):
            fold = conditions.index(g.condition) if named else i
            pieces += [Piece(i, a, b, fold) for a, b in groups.edges(g)]
        return tuple(pieces), "condition" if named else "sweep"
    (group,) = groups.groups
    cut = last_third(groups)
    if cut is None:
        return tuple(Piece(0, a, b, 0) for a, b in groups.edges(group)), "none"
    for (a, b), (first, last) in zip(groups.edges(group), group.blocks, strict=True):
        at = a + int(np.clip(cut - first, 0, last - first)) // groups.factor
        if at - a >= 16:
            pieces.append(Piece(0, a, at, 0))
        if b - at >= 16:
            pieces.append(Piece(0, at, b, 1))
    return tuple(pieces), "cycles"


def last_third(groups: Groups) -> int | None:
    """First sample of the last third of the cycles of the only group; None with too few."""
    (group,) = groups.groups
    begin = group.blocks[0][0]
    turns = group.loops.start[group.loops.start >= max(begin, 1)]
    cycles = turns.size // 2
    if cycles < 3:
        return None
    return int(turns[2 * (cycles - max(1, cycles // 3))])


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
    is found by sending known noise through the same projection.
    """
    found, _ = candidates(space, point.model)
    pairs = [pair for c in found for pair in c.pairs(point.model)]
    blocks = []
    for group in space.groups.groups:
        moving = space.moving(group, point, pairs)
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
            cut = columns[:, a:b]
            blocks.append((cut - cut.mean(axis=1, keepdims=True), moving[-1, a:b]))
    gram = sum(x @ x.T for x, _ in blocks)
    assert not isinstance(gram, int)
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    gram = gram / np.outer(size, size) + 1e-7 * np.eye(size.size)

    def left(targets: list[FloatArray]) -> list[FloatArray]:
        right = sum(x @ t for (x, _), t in zip(blocks, targets, strict=True)) / size
        beta = np.linalg.solve(gram, right) / size
        return [t - t.mean() - x.T @ beta for (x, _), t in zip(blocks, targets, strict=True)]

    residual = left([y for _, y in blocks])
    least = least_noise(space.groups)
    measured = spectrum_of(residual, least=least)
    current = measured
    for _ in range(ROUNDS):
        filter = Whitener(current, raised=0.0)
        noise = [filter.coloured(y.size, rng) for _, y in blocks]
        seen = spectrum_of(left(noise), least=1e-6 * least)
        want = np.clip(current.log_power - seen.log_power, -0.5, 4.0)
        change = np.interp(np.log(measured.frequency), np.log(current.frequency), want)
        current = Spectrum(
            measured.frequency, measured.log_power + change, measured.error * np.sqrt(2.0)
        )
    return current


def space_of(
    groups: Groups, spectrum: Spectrum, model: Model, raised: float | None = None
) -> tuple[Space, str]:
    """A prepared space, and what is held out."""
    pieces, kind = pieces_of(groups)
    whitener = Whitener(spectrum) if raised is None else Whitener(spectrum, raised)
    first = any(s.has_elements and s.id != "maxwell" for s in model.stages)
    space = Space(groups, pieces, whitener, scales_of(groups), first)
    space.prepare(model)
    return space, kind
