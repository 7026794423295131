"""Whether the displacement steps where the drive turns: a seat that slips, a part that catches.

Without repeats such steps are taken for slow noise, however large they are. Noise knows nothing of
where the drive turns: steps halfway between turning points say as much of it as steps at them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes.cause import Cause
from piezo_rig.diagnosis.chances import fisher_above
from piezo_rig.diagnosis.groups import Group
from piezo_rig.diagnosis.linear import Linear, Piece
from piezo_rig.diagnosis.refit import Fitted, changed_um, playable
from piezo_rig.diagnosis.space import Space

FloatArray = NDArray[np.float64]
FEWEST = 8  # turning points of a recording
MOST = 400  # of all; of more every so many are looked at
AT_ONCE = 16  # steps that are thinned together: recordings may be long
LITTLE = 1e-9  # squared length, of that of a column of unit length, that is no direction any more
BESIDE_BASE = 0.05  # of a step that must be left beside what the base can do


@dataclass(frozen=True)
class Slips:
    """``step_nm`` (rms) at turning points, and what all of them make, ``rms_nm``."""

    p_value: float
    step_nm: float
    rms_nm: float


def slips(space: Space, fitted: Fitted) -> Slips | None:
    """Steps at turning points, beside what those halfway between them take of the residual.

    Both beside what the base model and fine thresholds can follow. Their ratio (Fisher's law) does
    not hang on how well the spectrum is known. None where every drive was recorded more than once,
    so that noise is known, or hardly turns.
    """
    groups = space.groups.groups
    if all(g.repeats > 1 for g in groups):
        return None
    every = max(1, int(np.ceil(sum(_turns(g).size for g in groups) / MOST)))
    linear = fitted.linear
    at_turns, halfway = (
        _taken(space, linear, [_places(g, between)[::every] for g in groups])
        for between in (False, True)
    )
    if at_turns is None or halfway is None:
        return None
    ratio = at_turns.square / at_turns.rank / max(halfway.square / halfway.rank, 1e-300)
    real = max(1.0 - 1.0 / max(ratio, 1e-300), 0.0)  # not what noise alone would make
    chance = fisher_above(ratio, float(at_turns.rank), float(halfway.rank))
    step, rms = (1e3 * float(np.sqrt(real)) * x for x in (at_turns.step_um, at_turns.rms_um))
    return Slips(chance, step, rms)


def open_nm(space: Space, fitted: Fitted) -> float:
    """Rms of what laws of the speed may leave where the drive turns: a lag turns over there."""
    model = fitted.point.model
    members = [s for s in model.stages if isinstance(s, Cause) and s.of_speed]
    without = [(s, model.without(s.id)) for s in members]
    left = [1e3 * s.leaves * changed_um(space, less, model) for s, less in without
            if playable(space, less)]  # fmt: skip
    return float(np.linalg.norm(left))


@dataclass(frozen=True)
class _Taken:
    """``square`` that steps take of the whitened residual, ``rank`` directions that they have."""

    square: float
    rank: int
    step_um: float
    rms_um: float


def _taken(space: Space, linear: Linear, places: list[NDArray[np.int64]]) -> _Taken | None:
    """What steps at these samples of every group take, beside the base; None without any."""
    base, beside, own, grams, left, raws = [], [], [], [], [], []
    samples = 0.0
    for at, piece in enumerate(space.pieces):
        columns = _steps(space, piece, places[piece.group])
        frame, rows = linear.frame, linear.rows[at]
        kept = sum(frame.counts[:2])  # powers and fine thresholds
        known = np.vstack([frame.bands[at].white, frame.fixed[at].white[:kept], rows.white])
        white = space.whiten(columns, at) if len(columns) else columns
        base.append(known @ known.T)
        beside.append(known @ rows.left)
        own.append(white @ known.T)
        grams.append(white @ white.T)
        left.append(white @ rows.left)
        raws.append(piece.cells.centred(columns) if len(columns) else columns)
        samples += float(piece.cells.share.sum())
    steps = sum(len(x) for x in own)
    if not steps:
        return None
    gram = np.zeros((steps, steps))
    begin = 0
    for part in grams:
        gram[begin : begin + len(part), begin : begin + len(part)] = part
        begin += len(part)
    whole, cross = sum(base[1:], base[0]), np.vstack(own)
    size = np.sqrt(np.maximum(np.diag(whole), 1e-300))
    ridged = whole / np.outer(size, size) + LITTLE * np.eye(size.size)
    solved = np.linalg.solve(ridged, (cross / size).T)
    before = np.diag(gram).copy()
    gram -= (cross / size) @ solved
    right = np.concatenate(left) - solved.T @ (sum(beside[1:], beside[0]) / size)
    seen = np.diag(gram) > BESIDE_BASE * before
    if seen.sum() < FEWEST:
        return None
    gram, right = gram[np.ix_(seen, seen)], right[seen]
    shares = np.zeros(steps)
    values, vectors = np.linalg.eigh(gram)
    told = values > BESIDE_BASE**2 * float(np.median(np.diag(gram)))
    along = (vectors.T @ right)[told]
    shares[seen] = vectors[:, told] @ (along / values[told])
    power, begin = 0.0, 0
    for raw in raws:
        power += float(np.sum((shares[begin : begin + len(raw)] @ raw) ** 2))
        begin += len(raw)
    return _Taken(
        float(np.sum(along**2 / values[told])), int(told.sum()),
        float(np.sqrt(np.mean(shares[seen] ** 2))), float(np.sqrt(power / max(samples, 1.0))),
    )  # fmt: skip


def _steps(space: Space, piece: Piece, places: NDArray[np.int64]) -> FloatArray:
    """Steps (k, n) at the places that are within a piece, thinned."""
    group = space.groups.groups[piece.group]
    last = piece.first + len(piece.cells.marks) * piece.cells.factor
    mine = places[(places > piece.first) & (places < last - 1)]
    if not mine.size:
        return np.zeros((0, piece.end - piece.begin))
    samples = np.arange(group.drive_v.size)
    return np.vstack([
        space.groups.thinned(group, (samples >= some[:, None]).astype(float))[
            :, piece.begin : piece.end
        ]
        for some in np.split(mine, range(AT_ONCE, mine.size, AT_ONCE))
    ])  # fmt: skip


def _places(group: Group, between: bool) -> NDArray[np.int64]:
    """Turning points of a drive that was recorded once, or what is halfway between them."""
    turns = _turns(group)
    if turns.size < FEWEST or group.repeats > 1:
        return np.zeros(0, np.int64)
    return np.asarray((turns[:-1] + turns[1:]) // 2 if between else turns[1:-1])


def _turns(group: Group) -> NDArray[np.int64]:
    """Turning points within the stretches where the memory is known."""
    turns = np.unique(group.loops.start)
    inside = np.zeros(turns.size, bool)
    for a, b in group.blocks:
        inside |= (turns > a) & (turns < b)
    return np.asarray(turns[inside])
