"""How good every rung is on data that it never saw, and how much of that a finding brought.

Every fold is refitted from the Gram matrices about the full fit, then simulated and compared with
the raw recordings at full rate. Each block of a recording has its own free offset.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.diagnosis.chances import normal_half_width, student_half_width
from piezo_rig.diagnosis.compliances import element_step
from piezo_rig.diagnosis.covered import SHORT, covered, first_rise_within, grows
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.groups import Group, Groups
from piezo_rig.diagnosis.linear import Linear
from piezo_rig.diagnosis.refit import Fitted, parameter_step, settle
from piezo_rig.diagnosis.space import Space
from piezo_rig.errors import InputError

FloatArray = NDArray[np.float64]
FOLDS = 12
REPEATS = "sweep"  # every recording by a model that has not seen it
AGAIN = "repeats"  # the same, where some drives were recorded once: those by one that has
DRAWS = 2000
FEW, CHUNKS = 6, 10  # fewer recordings than this are cut into chunks for the interval
LEAST_FALL = 2e-4  # of the squared error; no group is expected to vary less
SLACK = 0.02  # of the range, by which a drive may leave what others span
FAR = 3.0  # standard errors that a fold may move a parameter
SHARES, HOLDS = (1.0, 0.5, 0.25, 0.1), 1.02  # of a fold's step; squared error, of that before


@dataclass(frozen=True, eq=False)
class Errors:
    """Squared errors of every recording, in the same order for every rung.

    Attributes
    ----------
    square, count : shape (r,), um^2 summed over samples, and samples
    group : shape (r,), which group each belongs to
    max_percent : largest error in percent of its recording's travel
    usual : shape (r,), as ``square``, each recording about what most of it lies beside the
        prediction by and not about its mean: where a drive goes further than all others the
        tables go where they like, and the mean with them; ``square`` where that is not known
    stretches : how many a recording is cut into
    """

    square: FloatArray
    count: FloatArray
    group: NDArray[np.int64]
    max_percent: float
    usual: FloatArray | None = None
    stretches: int = 1

    @property
    def rms_nm(self) -> float:
        return 1e3 * float(np.sqrt(self.square.sum() / self.count.sum()))

    @property
    def mostly_nm(self) -> float:
        """Rms error without the worst stretch of every recording that is cut into stretches, each
        about where most of it lies: of few conditions the largest is the one that rises, once,
        where no other has been.
        """
        if self.usual is None or self.stretches < 2:
            return self.rms_nm
        kept = np.ones(self.usual.size, bool)
        of = self.group // self.stretches
        for one in np.unique(of):
            at = np.flatnonzero(of == one)
            if at.size > 1:
                kept[at[np.argmax(self.usual[at] / np.maximum(self.count[at], 1e-300))]] = False
        return 1e3 * float(np.sqrt(self.usual[kept].sum() / self.count[kept].sum()))

    @property
    def typical_nm(self) -> float:
        """Geometric mean of the recordings' rms errors: none of them outweighs the others."""
        square = self.square if self.usual is None else self.usual
        mean = square / np.maximum(self.count, 1e-300)
        return 1e3 * float(np.exp(0.5 * np.mean(np.log(np.maximum(mean, 1e-300)))))


def reported_kind(groups: Groups, kind: str) -> str:
    """Recordings are left out where there are several of every drive, else what `engine` says."""
    return REPEATS if repeated(groups) else kind


def repeated(groups: Groups) -> bool:
    """Whether every drive was recorded more than once."""
    return all(g.repeats > 1 for g in groups.groups)


def extrapolates(space: Space) -> bool:
    """Whether the cycles that are held out go further than those that are not."""
    begin = min((p.first for p in space.pieces if p.fold == 1), default=0)
    return begin > 0 and any(grows(g, begin) for g in space.groups.groups)


def without_first_rises(space: Space) -> bool:
    """Whether the last cycles of a single recording are held out, and the first rise before them.
    """
    (group, *others), pieces = space.groups.groups, space.pieces
    begin = min((p.first for p in pieces if p.fold == 1), default=0)
    alone = not others and group.repeats == 1
    return alone and begin > 0 and first_rise_within(group, begin)


def carried_over_nm(space: Space, fitted: Fitted, kind: str) -> float:
    """Rms error on conditions or sweeps that were left out and lie inside what the others span.

    Beyond that the element tables go where they like, with the right cause as with a wrong one.
    """
    if kind not in ("condition", "sweep"):
        return held_out_errors(space, fitted, kind).rms_nm
    inside = spanned(space)
    return held_out_errors(space, fitted, kind, only=inside).rms_nm if inside else 0.0


def spanned(space: Space) -> list[int]:
    """The folds whose drives go no further than those of all others."""
    return [
        k for k in sorted({p.fold for p in space.pieces})
        if _inside(space.groups, [p.group for p in space.pieces if p.fold == k])
    ]  # fmt: skip


def _inside(groups: Groups, left_out: Sequence[int]) -> bool:
    """Whether the drives of some groups lie within the drives of the others, and none of them goes
    further at once than one of those: 10 to 55 V and 75 to 40 V say nothing of 10 to 75 V. Nor
    does a loop say how a first rise goes on.
    """
    rest = [g for i, g in enumerate(groups.groups) if i not in left_out]
    if not rest:
        return False
    low = min(float(g.drive_v.min()) for g in rest)
    high = max(float(g.drive_v.max()) for g in rest)
    furthest = max(float(np.ptp(g.drive_v)) for g in rest)
    slack = SLACK * (high - low)
    drives = [groups.groups[i].drive_v for i in left_out]
    risen = max((_risen(g) for g in rest), default=0.0)
    return all(
        d.min() >= low - slack and d.max() <= high + slack and np.ptp(d) <= furthest + slack
        for d in drives
    ) and all(_risen(groups.groups[i]) <= risen + slack for i in left_out)


def _risen(group: Group) -> float:
    """How far a group goes along the first rise, volts; 0 unless it begins virgin."""
    return float(np.max(np.abs(group.drive_v - group.drive_v[0]))) if group.virgin else 0.0


def held_out_errors(
    space: Space,
    fitted: Fitted,
    kind: str,
    measured: Groups | None = None,
    only: Sequence[int] | None = None,
) -> Errors:
    """Errors of one rung on what its refits did not see; in the fit itself where kind is none.

    ``measured`` : other recordings of the same groups to score on; ``only`` : folds to leave out
    """
    groups, pieces = space.groups, space.pieces
    point = fitted.point
    if kind == AGAIN or (kind == REPEATS and repeated(groups)):
        return _left_out(space, fitted, measured or groups)
    folds = sorted({p.fold for p in pieces}) if only is None else list(only)
    if only is None and kind in ("condition", "sweep"):
        folds = spanned(space) or folds  # beyond the others' drives tables go where they like
    plan: list[tuple[list[int], list[int]]] = []
    if kind == "cycles":
        plan.append(([i for i, p in enumerate(pieces) if p.fold == 0],
                     [i for i, p in enumerate(pieces) if p.fold == 1]))  # fmt: skip
    elif kind == "none" or (point.fixed and not point.values().size):
        every = list(range(len(pieces)))
        plan.append((every, [i for i in every if kind == "none" or pieces[i].fold in folds]))
    else:
        joined = [folds[k::FOLDS] for k in range(min(FOLDS, len(folds)))]
        for out in joined:
            plan.append(([i for i, p in enumerate(pieces) if p.fold not in out],
                         [i for i, p in enumerate(pieces) if p.fold in out]))  # fmt: skip
    squares: dict[tuple[int, int, int], NDArray[np.float64]] = {}
    scored = {pieces[i].group for _, held in plan for i in held}
    few = sum(groups.groups[g].repeats for g in scored) < FEW
    worst = 0.0
    for train, held in plan:
        model = point.model
        if len(train) < len(pieces):
            model = _fold(space, fitted, train, held)
        for g in sorted({pieces[i].group for i in held}):
            group = (measured or groups).groups[g]
            try:
                group.predicted(model)
                played = model
            except InputError:
                played = point.model
            begin = 0
            if kind == "cycles":
                begin = min(pieces[i].first for i in held)
            kept = covered(group, begin) if begin else []
            for r, row in enumerate(group.measured_um):
                predicted = group.predicted_of(played, [r])
                for a, b in group.blocks:
                    if b - max(a, begin) < SHORT:
                        continue
                    error = row[a:b] - predicted[a:b]
                    cut = _scored(error - error.mean(), a, kept, begin)
                    parts = np.array_split(cut, CHUNKS if few else 1)
                    usual = float(np.median([p.mean() for p in parts if p.size] or [0.0]))
                    for c, part in enumerate(parts):
                        own, off = float(part @ part), part - usual
                        at = squares.setdefault((g, r, c), np.zeros(3))
                        at += own, part.size, float(off @ off) if few else own
                    travel = float(np.ptp(row))
                    most = float(np.max(np.abs(cut), initial=0.0))
                    worst = max(worst, 100.0 * most / max(travel, 1e-12))
    keys = sorted(squares)
    values = np.array([squares[k] for k in keys])
    return Errors(
        values[:, 0],
        values[:, 1],
        np.array([k[0] * (CHUNKS if few else 1) + k[2] for k in keys]),
        worst,
        values[:, 2],
        CHUNKS if few else 1,
    )


def _scored(
    error: FloatArray, first: int, kept: Sequence[tuple[int, int]], begin: int
) -> FloatArray:
    """Of the errors of a block, which begins at sample ``first``, those that are scored.

    All, or of those from ``begin`` on the stretches that are ``kept``: they go no further than
    what came before. After an excursion the offset is free again.
    """
    if begin == 0:
        return error
    parts, last = [], first + error.size
    for a, b in kept:
        a, b = max(a, first), min(b, last)
        if b - a >= SHORT:
            parts.append(error[a - first : b - first])
    if len(parts) == 1 and parts[0].size == last - max(first, begin):
        return parts[0]
    return np.concatenate([p - p.mean() for p in parts]) if parts else np.zeros(0)


def _left_out(space: Space, fitted: Fitted, measured: Groups) -> Errors:
    """Every recording scored by a model that was refitted without it."""
    point = fitted.point
    settle(space, point)
    about = space.about(point, fitted.linear)
    squares, counts, of, worst = [], [], [], 0.0
    models = []
    for row, linear in enumerate(space.left_out(about, point)):
        change = np.zeros(len(point.sizes))
        if change.size:
            change, _ = parameter_step(point, linear, fitted.scales, held=True)
            change = _bounded(point, fitted, change)

        def on_the_rest(model: Model, row: int = row) -> float:
            return sum(
                _square(g, model, [r for r in range(g.repeats) if r != row], g.blocks)
                for g in measured.groups
            )

        moved = partial(_moved, point, linear, None, change)
        models.append(_as_far_as_it_holds(moved, on_the_rest, point.model))
    for g, group in enumerate(measured.groups):
        for r in range(group.repeats):
            try:
                predicted = group.predicted_of(models[r], [r])
            except InputError:
                predicted = group.predicted_of(point.model, [r])
            for a, b in group.blocks:
                error = group.measured_um[r, a:b] - predicted[a:b]
                error = error - error.mean()
                squares.append(float(error @ error))
                counts.append(error.size)
                of.append(g)
                travel = float(np.ptp(group.measured_um[r]))  # of all of it, scored or not
                worst = max(worst, 100.0 * float(np.max(np.abs(error))) / max(travel, 1e-12))
    return Errors(np.array(squares), np.array(counts, float), np.array(of), worst)


def _bounded(point: Point, fitted: Fitted, change: FloatArray) -> FloatArray:
    """A fold's step of the parameters (q,), kept within what folds can plausibly do."""
    spread = np.sqrt(np.diag(fitted.covariance))
    size = np.array([s for _, _, s in point.sizes])
    change = np.clip(change, -FAR * spread, FAR * spread)
    return np.asarray(np.clip(change, -100.0 * size, 100.0 * size))


def _as_far_as_it_holds(
    moved: Callable[[float], Model], square: Callable[[Model], float], whole: Model
) -> Model:
    """The model of a fold, moved from that of all data as far as the columns there are true.

    They are products of what is fitted: where data hardly know two such numbers apart, both may
    move far, and what was trained on comes out worse than where they stay. Then only a share of
    the step is taken.

    Parameters
    ----------
    moved : the model after a share of the step
    square : squared error on what it was trained on
    """
    still = moved(0.0)
    tried = [(square(still), 0.0, still)]
    enough = HOLDS * min(square(whole), tried[0][0])
    for share in SHARES:
        model = moved(share)
        tried.append((square(model), share, model))
        if tried[-1][0] <= enough:
            return model
    return min(tried, key=lambda t: t[:2])[2]


def _square(
    group: Group, model: Model, rows: Sequence[int], blocks: Sequence[tuple[int, int]]
) -> float:
    """Squared error of some recordings on such blocks, each with its own offset; um^2 summed."""
    if not rows:
        return 0.0
    try:
        predicted = group.predicted_of(model, rows)
    except InputError:
        return np.inf
    total = 0.0
    for a, b in blocks:
        error = group.measured_um[rows, a:b] - predicted[a:b]
        error -= error.mean(axis=1, keepdims=True)
        total += float(np.vdot(error, error))
    return total


def refold(point: Point, fitted: Fitted, train: Sequence[int]) -> Point:
    """The point refitted on some of the pieces, from the Gram matrices about the full fit."""
    change = _change(point, fitted, train)
    return replace(point, model=_moved(point, fitted.linear, train, change, 1.0))


def _fold(space: Space, fitted: Fitted, train: Sequence[int], held: Sequence[int]) -> Model:
    """The model refitted on some of the pieces; how far is judged by what was before those held
    out, or by the widest drive of the others.
    """
    point, pieces, groups = fitted.point, space.pieces, space.groups.groups
    change = _change(point, fitted, train)
    trained, tested = {pieces[i].group for i in train}, {pieces[i].group for i in held}
    judged = trained & tested or {max(trained, key=lambda g: float(np.ptp(groups[g].drive_v)))}
    ends = {g: groups[g].drive_v.size for g in judged}
    for piece in (pieces[i] for i in held if pieces[i].group in ends):
        ends[piece.group] = min(ends[piece.group], piece.first)

    def on_trained(model: Model) -> float:
        return sum(
            _square(groups[g], model, range(groups[g].repeats),
                    [(a, min(b, end)) for a, b in groups[g].blocks if min(b, end) - a >= SHORT])
            for g, end in ends.items()
        )  # fmt: skip

    moved = partial(_moved, point, fitted.linear, train, change)
    return _as_far_as_it_holds(moved, on_trained, point.model)


def _change(point: Point, fitted: Fitted, train: Sequence[int]) -> FloatArray:
    """What some of the pieces would change of the parameters (q,)."""
    if not point.sizes:
        return np.zeros(0)
    change, _ = parameter_step(point, fitted.linear, fitted.scales, train, held=True)
    return _bounded(point, fitted, change)


def _moved(
    point: Point, linear: Linear, train: Sequence[int] | None, change: FloatArray, share: float
) -> Model:
    """A model with a share of such a change, and what is linear fitted to it."""
    n = point.linear
    values = point.values()
    values[n:] += share * change
    values[:n] += element_step(point, linear, train, share * change)
    return point.moved(values).model


def gain(before: Errors, after: Errors, rng: np.random.Generator) -> tuple[float, list[float]]:
    """Relative fall of the rms in percent, with a 95 % interval.

    Where there are repeats, the spread is that between them (what a new recording of the same
    conditions would show), else that between whatever was held out. It counts twice, for the
    recordings that gave the figure and for the new ones that would check it.
    """
    value = 100.0 * (1.0 - after.rms_nm / max(before.rms_nm, 1e-12))
    members = [np.flatnonzero(before.group == g) for g in np.unique(before.group)]
    if all(m.size > 1 for m in members):
        half = _between_repeats(before, after, members)
        return value, [value - half, min(value + half, 100.0)]
    drawn = np.empty(DRAWS)
    for k in range(DRAWS):
        pick = np.concatenate([members[i] for i in rng.integers(len(members), size=len(members))])
        ratio = after.square[pick].sum() / max(before.square[pick].sum(), 1e-300)
        drawn[k] = 100.0 * (1.0 - np.sqrt(ratio))
    freedom = max(len(members) - 1, 2)
    inflate = np.sqrt(2.0) * student_half_width(freedom) / normal_half_width()
    low, high = np.percentile(drawn, [2.5, 97.5])
    return value, [value - inflate * (value - low), min(value + inflate * (high - value), 100.0)]


def _between_repeats(
    before: Errors, after: Errors, members: Sequence[NDArray[np.int64]]
) -> float:
    """Half width of a gain's interval in percent, from repeats.

    What noise does to the fall of a squared error grows with that fall, because it is twice the
    product of the noise with what was taken away. A single pair of repeats says little of its own
    spread; all of them together say how large it is for their fall.
    """
    ratio = float(after.square.sum() / max(before.square.sum(), 1e-300))
    off = after.square - ratio * before.square
    share = np.array([_fallen(before, after, m, ratio) for m in members])
    freedom = np.array([m.size - 1.0 for m in members])
    # variance of the sum over a group, of what its fall makes expect
    found = np.array([m.size * np.var(off[m], ddof=1) for m in members]) / share
    variance = float(freedom @ found / freedom.sum() * share.sum())
    of_rms = 50.0 * np.sqrt(2.0 * variance / max(ratio, 1e-300)) / max(before.square.sum(), 1e-300)
    return float(student_half_width(max(freedom.sum(), 2.0)) * of_rms)


def _fallen(before: Errors, after: Errors, m: NDArray[np.int64], ratio: float) -> float:
    """Fall of a group's squared error, and what noise does without any.

    A group whose error hardly falls is still compared with the others' ratio of after to before:
    of the noise's own square a share of 1 - ratio shows, with a variance that is half as large as
    that of its product with a fall of the same size.
    """
    fall = float(np.sum(before.square[m] - after.square[m]))
    own = 0.5 * (1.0 - ratio) ** 2 + LEAST_FALL
    return max(fall, 0.0) + own * float(np.sum(after.square[m])) + 1e-300
