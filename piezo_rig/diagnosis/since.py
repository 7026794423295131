"""Gain and sensitivity against a given model that lacks causes.

A model that was off by many times the noise where it was identified is no yardstick for what is
smaller. Its recordings are: where the model file has them and the same drives are played again,
what has changed since is what differs between the two. Only what a refit hides is asked of that,
the amplifier's gain and the sensor's sensitivity; everything else is found by refitting.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes import CAUSES, NAMED_MODELS
from piezo_rig.chain import Model, Parameter, Stage
from piezo_rig.diagnosis.chances import student_above, student_half_width
from piezo_rig.diagnosis.checks import FAR_OFF
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.held import best_um_of
from piezo_rig.diagnosis.scan import LEVEL
from piezo_rig.identification.recorded import Recorded, cells, recorded_of, together
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]
LEFT = 0.3  # of the change may be left by what is to explain it
UNITS = 8  # stretches of the recordings that are counted as one observation each, at least
APART = 3.0  # standard errors between what two explanations leave
PLAINLY = 3.0  # times what the best leaves: more needs no statistics
GAIN, SCALE = "drive-gain", "sensor-scale"
STEP = 1e-3
ROUNDS = 3
FARTHEST = (0.8, 1.25)  # ratio of a gain that is looked for


class Block(NamedTuple):
    """Where in the new recordings a drive is played again: from which sample of which group on."""

    group: int
    first: int
    cell: int
    points: int

    def of(self, values: FloatArray) -> FloatArray:
        """Values (..., n) of the group, as averages over cells."""
        last = self.first + self.cell * self.points
        return cells(values[..., self.first : last], self.cell)


@dataclass(frozen=True, eq=False)
class Compared:
    """New recordings beside those that a model was identified from.

    Attributes
    ----------
    before, now : displacement, every unit counted from its own mean; um
    unit : which observation each point belongs to
    blocks : where they are
    """

    before: FloatArray
    now: FloatArray
    unit: NDArray[np.int64]
    blocks: tuple[Block, ...]

    @property
    def changed_um(self) -> float:
        return _rms(self.before - self.now)

    @property
    def scale(self) -> float:
        """The factor that makes the new displacement what it was."""
        return float(self.now @ self.before / (self.now @ self.now))

    @property
    def like_a_scale(self) -> bool:
        """Whether a scale, or what looks like one, has changed and little else."""
        return _rms(self.before - self.scale * self.now) <= LEFT * self.changed_um

    def curve(self, of: Callable[[int], FloatArray]) -> FloatArray:
        """Values (n,) of every group, in the shape of ``now``."""
        return _centred(np.concatenate([b.of(of(b.group)) for b in self.blocks]), self.unit)


@dataclass(frozen=True, eq=False)
class Change:
    """What has changed since.

    Attributes
    ----------
    stage : gain or scale, with the interval of its ratio
    left_nm : what it leaves of the change, rms
    p_value : family-wise
    alternatives : what these data cannot tell from it
    """

    stage: Stage
    left_nm: float
    p_value: float
    alternatives: tuple[str, ...]


def lacks_causes(model: Model, floor_nm: float, groups: Groups) -> bool:
    """Whether a given model by `identify` was far off even there, a bend beside it or not."""
    own_um = best_um_of(model, groups)
    known = np.isfinite(own_um) and model.name in NAMED_MODELS
    return bool(known and 1e3 * own_um >= FAR_OFF * floor_nm)


def compared(groups: Groups, sweeps: Sequence[Sweep], model: Model) -> Compared | None:
    """New recordings beside the model's own of the same drives; None without any.

    Parameters
    ----------
    groups : of the sweeps
    """
    placed = [
        (recorded, block) for recorded in recorded_of(model.provenance)
        if (block := _place(groups, sweeps, recorded)) is not None
    ]  # fmt: skip
    if not placed:
        return None
    pieces = int(np.ceil(UNITS / len(placed)))
    before, now, units = [], [], []
    for k, (recorded, block) in enumerate(placed):
        before.append(recorded.displacement_um[: block.points])
        now.append(block.of(together(groups.groups[block.group].measured_um)))
        units.append(k * pieces + np.arange(block.points) * pieces // block.points)
    unit = np.concatenate(units)
    return Compared(
        _centred(np.concatenate(before), unit), _centred(np.concatenate(now), unit), unit,
        tuple(block for _, block in placed),
    )  # fmt: skip


def _place(groups: Groups, sweeps: Sequence[Sweep], recorded: Recorded) -> Block | None:
    again = set(recorded.again(sweeps))
    for g, group in enumerate(groups.groups):
        first = 0
        for i in group.sweeps[0]:
            rest = group.drive_v.size - first
            points = min(recorded.displacement_um.size, rest // recorded.cell)
            if i in again and points >= UNITS:
                return Block(g, first, recorded.cell, points)
            first += sweeps[i].samples
    return None


def change_since(
    both: Compared, groups: Groups, model: Model, tried: int
) -> Change | None:
    """Gain or scale, whichever makes the new recordings what the old ones were; None if neither.

    Parameters
    ----------
    groups, model : the new recordings times ``both.scale``, and what describes them
    tried : how many causes were, for the correction
    """
    def played(extended: Model) -> FloatArray:
        return both.curve(lambda g: groups.groups[g].predicted_once(extended)) / scale

    scale = both.scale
    plain = played(model)
    explained = [_Explained(SCALE, {}, scale, both.before - scale * both.now, both.now)]
    for stays_v in ({}, {"stays_v": groups.offset_v}) if groups.offset_v else ({},):
        explained.append(_gain_since(
            both, lambda back: played(model.with_stage(back)) - plain, stays_v
        ))  # fmt: skip
    best = min(explained, key=lambda e: _rms(e.left))
    if _rms(best.left) > LEFT * both.changed_um:
        return None
    spread, freedom = best.spread(both.unit)
    p = 2.0 * student_above(abs(best.ratio - 1.0) / max(spread, 1e-300), freedom)
    if p * tried >= LEVEL:
        return None
    half = student_half_width(freedom) * spread
    ratio = Parameter(best.ratio, "1", (best.ratio - half, best.ratio + half))
    stage = CAUSES[best.cause].of(None, ratio=best.ratio, **best.stays_v)
    stage = type(stage)({**stage.parameters, "ratio": ratio}, stage.elements)
    alike = {e.cause for e in explained if e.cause != best.cause and not _apart(best, e, both.unit)}
    return Change(stage, 1e3 * _rms(best.left), min(p * tried, 1.0), tuple(alike))


@dataclass(frozen=True, eq=False)
class _Explained:
    """One explanation: its ratio, what it leaves, and the derivative of that by the ratio."""

    cause: str
    stays_v: dict[str, float]
    ratio: float
    left: FloatArray
    slope: FloatArray

    def spread(self, unit: NDArray[np.int64]) -> tuple[float, int]:
        """Standard error of the ratio, each unit left out once, and its degrees of freedom."""
        right = np.bincount(unit, self.slope * self.left)
        square = np.bincount(unit, self.slope**2)
        without = (right.sum() - right) / np.maximum(square.sum() - square, 1e-300)
        n = without.size
        return float(np.sqrt((n - 1) / n * np.sum((without - without.mean()) ** 2))), n - 1


def _gain_since(
    both: Compared, moved: Callable[[Stage], FloatArray], stays_v: dict[str, float]
) -> _Explained:
    """The gain that makes the new recordings what the old ones were, by Gauss-Newton.

    ``moved`` : what a drive that is put right changes of the new recordings
    """
    def at(ratio: float) -> FloatArray:
        return moved(CAUSES[GAIN].of(None, ratio=1.0 / ratio, **stays_v))

    ratio = 1.0
    for last in range(ROUNDS + 1):
        here = at(ratio)
        slope, left = (at(ratio + STEP) - here) / STEP, both.before - both.now - here
        if last < ROUNDS:
            ratio = float(np.clip(ratio + slope @ left / (slope @ slope), *FARTHEST))
    return _Explained(GAIN, stays_v, ratio, left, slope)


def _apart(best: _Explained, other: _Explained, unit: NDArray[np.int64]) -> bool:
    """Whether one leaves clearly less than the other, unit by unit or altogether."""
    if _rms(other.left) > PLAINLY * _rms(best.left):
        return True
    less = np.bincount(unit, other.left**2 - best.left**2)
    n = less.size
    return bool(less.sum() > APART * np.sqrt(n * np.var(less, ddof=1)))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _centred(values: FloatArray, unit: NDArray[np.int64]) -> FloatArray:
    means = np.bincount(unit, values) / np.bincount(unit)
    return np.asarray(values - means[unit])
