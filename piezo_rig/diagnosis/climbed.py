"""From clean recordings to a ladder: the noise, the space that causes are scored in, the climb."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes.cause import Cause
from piezo_rig.chain import Model
from piezo_rig.diagnosis import engine
from piezo_rig.diagnosis.alike import (
    ages_unseen,
    differ,
    numbers_apart,
    of_one_history,
    plainly_apart,
)
from piezo_rig.diagnosis.between import turn_between
from piezo_rig.diagnosis.chances import AS_HELD, as_held
from piezo_rig.diagnosis.climb import climb
from piezo_rig.diagnosis.early import Reading, noise_floor_nm
from piezo_rig.diagnosis.first_look import look, on_all, some_of
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.forms import converged
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.held import own_um_of
from piezo_rig.diagnosis.held_out import (
    AGAIN,
    REPEATS,
    Errors,
    carried_over_nm,
    extrapolates,
    gain,
    held_out_errors,
    reported_kind,
    spanned,
)
from piezo_rig.diagnosis.held_out import repeated as all_repeated
from piezo_rig.diagnosis.in_order import bends_first, in_order
from piezo_rig.diagnosis.kinks import as_in, with_kinks
from piezo_rig.diagnosis.ladder import Ladder, Step
from piezo_rig.diagnosis.monitored import corrected, freed, taken_in
from piezo_rig.diagnosis.over_scales import over_scales
from piezo_rig.diagnosis.patience import Patience
from piezo_rig.diagnosis.put_right import put_right
from piezo_rig.diagnosis.reaches import Intervals, Known, at_their_reaches
from piezo_rig.diagnosis.refit import Fitted, refit, settle
from piezo_rig.diagnosis.scale import on_one_scale
from piezo_rig.diagnosis.space import Space
from piezo_rig.diagnosis.spare import faded, one_by_one
from piezo_rig.diagnosis.unsteady import Unsteady, unsteady
from piezo_rig.diagnosis.wandering import AGEING
from piezo_rig.diagnosis.warming import without_settling
from piezo_rig.diagnosis.whitening import CellWhitener

FloatArray = NDArray[np.float64]
Gate = tuple[Callable[[Fitted], float], float]
WORSE, STRICT, AWAY = 1.03, 1.01, 3.0  # by which an extension may raise held-out errors
ROUNDS, SETTLED = 3, 0.05  # of what is left in memory; the share by which it has changed
PERIODIC = "periodic-nonlinearity"
LOUD = 0.5  # of the noise beside the baseline, that beside a better model, below which it was none
CLOSE = 1.3  # times the noise floor: nearly nothing is left, and a true cause does no harm


@dataclass(eq=False)
class Climbed:
    """A ladder, and what it was climbed with.

    Attributes
    ----------
    folds, kind : how things were held out to see whether a model carries over, and for the figures
    judged : and for the climb. A model that lacks an effect is judged by one of two drives that it
        has not seen for what the other does not show
    floor_nm : noise of one recording; None without repeats
    repeated : whether the noise was measured between repeats
    first : the baseline; the ladder is climbed from the last of ``monitored``, if there are any
    monitored, said : rungs that the drive monitor gives, or what recordings of one drive differ
        by; what is to be said of those it does not
    reading : of the drive monitor, with the delay as the displacement has it
    spread : intervals that are not those of a linear fit
    known : how far laws reach, as far as that has been looked for
    turned : the model that says that the drive turns between samples, if one does; the ladder was
        not climbed to its end then
    kinked : the model that has its break points where the data do, likewise
    """

    space: Space
    folds: str
    kind: str
    floor_nm: float | None
    repeated: bool
    first: Fitted
    judged: str
    monitored: list[Step] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    reading: Reading | None = None
    spread: Intervals = field(default_factory=dict)
    known: dict[str, Known] = field(default_factory=dict)
    turned: Model | None = None
    kinked: Point | None = None
    ladder: Ladder = field(init=False)
    _known: dict[int, tuple[Point, Errors]] = field(default_factory=dict)
    _gain: tuple[Groups, Model, Unsteady | None] | None = None

    def errors(self, fitted: Fitted) -> Errors:
        """Held-out errors of a rung, as it is judged."""
        key = id(fitted.point)  # held, so that it stays its own; the matrices are too large for it
        if key not in self._known:
            self._known[key] = fitted.point, held_out_errors(self.space, fitted, self.judged)
        return self._known[key][1]

    def error_nm(self, fitted: Fitted) -> float:
        """Held-out error of a rung, as it is judged."""
        return self.errors(fitted).rms_nm

    @property
    def held_out(self) -> str:
        """What was left out for the figures, in the contract's words."""
        return REPEATS if self.kind == AGAIN else self.kind

    def figures(self, fitted: Fitted) -> Errors:
        """Errors of a rung, as they are reported."""
        if self.kind == self.judged:
            return self.errors(fitted)
        return held_out_errors(self.space, fitted, self.kind)

    def unsteady(self, groups: Groups) -> Unsteady | None:
        """How far the gain changes among recordings of these drives beside the last model."""
        model = self.ladder.last.point.model
        if self._gain is None or self._gain[0] is not groups or self._gain[1] is not model:
            self._gain = groups, model, unsteady(groups, self.space.whitener, model)
        return self._gain[2]

    @property
    def noise_nm(self) -> float:
        """Noise of one recording, what no model falls below."""
        return self.floor_nm or self.space.sample_noise_nm

    def helps(
        self, less: Fitted, fitted: Fitted, unseen: bool = True, others: bool = True
    ) -> bool:
        """Whether the second fit predicts recordings better than the first, beyond doubt.

        ``unseen`` : the answer where nothing is held out
        ``others`` : recordings that nobody has made yet, which differ as much as these do
        """
        if self.judged == "none":
            return unseen
        rng = np.random.default_rng(0)
        value, (low, _) = gain(self.errors(less), self.errors(fitted), rng)
        return value > (value - low) / (1.0 if others else np.sqrt(2.0))

    def predicting_better(
        self, kinked: Point | None, first: Fitted, fitted: Fitted
    ) -> Point | None:
        """A model with more break points, if with them it predicts better what was held out, and
        so does the baseline.
        """
        if kinked is None:
            return None
        bare = refit(self.space, as_in(first.point, kinked))
        whole = refit(self.space, kinked)
        better = self.error_nm(bare) < self.error_nm(first)
        return kinked if better and self.error_nm(whole) < self.error_nm(fitted) else None

    def gates(self, first: Fitted) -> Sequence[Gate]:
        """Errors that an extension of a model may not raise, each by more than a factor."""

        def typical(fitted: Fitted) -> float:
            return self.errors(fitted).typical_nm

        def mostly(fitted: Fitted) -> float:
            return self.errors(fitted).mostly_nm

        def carries_over(fitted: Fitted) -> float:
            return carried_over_nm(self.space, fitted, self.folds)

        # where the largest condition has to be left out with the others, for none goes as far, it
        # says more than all of them together: only what runs away is refused
        if self.judged == "condition":
            return [(typical, WORSE), (mostly, AWAY)]
        close = self.floor_nm is not None and self.error_nm(first) < CLOSE * self.floor_nm
        gates: list[Gate] = [(self.error_nm, STRICT if close else WORSE)]
        alone = self.judged in (self.folds, "none") or self.folds == "sweep"
        return gates if alone else [*gates, (carries_over, AWAY)]


def climbed(
    clean: Groups, start: Point, rng: np.random.Generator, tell: Callable[[str], None], others: int,
    reading: Reading | None = None, brief: bool = False, patience: Patience | None = None,
) -> Climbed:
    """The ladder of recordings that are clean of events and hum.

    Recordings of one drive that were played after different ones are no repeats where memory is
    left, or where the actuator ages with every cycle. That is fitted, and they are compared as if
    played after the same ones.

    Parameters
    ----------
    others : causes that were tried elsewhere (on the raw recordings), for the correction
    reading : of the drive monitor
    brief : whether a model that explains most is all that is asked for, if there is more to explain
    patience : how much was tried before
    """
    patience = patience or Patience()
    known, left = plainly_apart(clean, start.model), tuple[float, ...]()
    same = clean if known is None else of_one_history(clean, known)
    for _ in range(ROUNDS):
        out = _climbed(same, start, rng, tell, others, reading, patience, brief)
        if out.turned is not None:
            return out
        last = out.ladder.last.point.model
        before, left = left, numbers_apart(last)
        if known is not None and not differ(clean, last):
            if (aged := _as_aged(clean, out, start, rng, tell, others, reading, patience, brief)):
                return aged
            out = _climbed(clean, start, rng, tell, others, reading, patience, brief)
            break
        if not differ(clean, last) or _near(before, left):
            break
        tell("recordings as if played after the same ones")
        same = of_one_history(clean, last)
    return _as_aged(clean, out, start, rng, tell, others, reading, patience, brief) or out


def _as_aged(
    clean: Groups, search: Climbed, start: Point, rng: np.random.Generator,
    tell: Callable[[str], None], others: int, reading: Reading | None, patience: Patience,
    brief: bool,
) -> Climbed | None:
    """The ladder of recordings as if made at one count of cycles, where it lacks an ageing that
    they show; None where they do not.
    """
    unseen = None if brief else ages_unseen(
        clean, search.space.whitener, search.ladder.last.point.model, search.unsteady
    )  # fmt: skip
    if unseen is None:
        return None
    tell("recordings as if made at the same count of cycles")
    same = of_one_history(clean, unseen[0])
    return _climbed(same, start, rng, tell, others, reading, patience, told=unseen)


def fitted_anew(
    search: Climbed, last: Fitted, tell: Callable[[str], None]
) -> Climbed:
    """The same ladder in the space of other recordings of the same drives.

    ``last`` : its last model, fitted there
    """
    out = replace(search, space=last.space, first=refit(last.space, search.first.point), _known={})
    steps = [*search.ladder.steps]
    steps[-1] = replace(steps[-1], fitted=last)
    out.ladder = replace(
        search.ladder, first=out.first, steps=tuple(one_by_one(last.space, steps, tell))
    )
    return out


def _near(before: tuple[float, ...], left: tuple[float, ...]) -> bool:
    return len(before) == len(left) and bool(np.allclose(before, left, rtol=SETTLED))


def _climbed(
    clean: Groups, start: Point, rng: np.random.Generator, tell: Callable[[str], None], others: int,
    reading: Reading | None, patience: Patience, brief: bool = False,
    told: tuple[Model, float] | None = None, kinked: bool = False, better: Point | None = None,
) -> Climbed:
    """
    Parameters
    ----------
    told : a model with the ageing that recordings of one drive show, and its chance
    kinked : whether the baseline has its break points where the data have them
    better : what noise is known beside, where nothing but a model shows it, if not the baseline
    """
    tell("noise")
    clean = on_one_scale(clean, start.model)
    settled = without_settling(clean, start.model)
    whitener, repeated = engine.noise_of(settled, better or start, rng)
    out = _set_out(clean, whitener, repeated, start, settled)
    if not kinked and (there := with_kinks(out.space, out.first)) is not None:
        finer = _set_out(clean, whitener, repeated, there, settled)
        if finer.error_nm(finer.first) < out.error_nm(out.first):
            kinked, start, out = True, there, finer
    space, first = out.space, out.first
    out.reading = reading
    if reading is not None:
        tell("what the drive monitor says")
        out.monitored, out.said = taken_in(space, first, reading)
        if out.monitored:
            first = out.monitored[-1].fitted
    if told is not None:
        stage = told[0].stage(AGEING)
        assert stage is not None
        point = replace(first.point, model=first.point.model.with_stage(stage))
        first = refit(space, point)
        out.monitored.append(Step(AGEING, told[1], first))
    asked = [first] if kinked else []

    def stop(fitted: Fitted, best: Fitted) -> bool:
        turns = turn_between(space, fitted, first, best=best)
        out.turned = fitted.point.model if turns else None
        if out.turned is None and not asked:  # beside the first cause; rivals tell no more
            asked.append(fitted)
            out.kinked = out.predicting_better(with_kinks(space, fitted), first, fitted)
        return out.turned is not None or out.kinked is not None

    some, begun = None if start.fixed else some_of(clean), list[Step]()
    if some is not None:
        tell(f"{len(some.groups)} drives of {len(clean.groups)}")
        part = _set_out(some, whitener, repeated, first.point)
        part.space.excluded, part.space.longest = space.excluded, space.longest
        looked = look(
            part.space, part.first, rng, tell, part.gates(part.first), part.noise_nm, others,
            part.helps, brief,
        )  # fmt: skip
        begun, out.known = on_all(space, looked, out.error_nm, tell)
    out.ladder = climb(
        space, first, rng, tell, out.gates(first), out.noise_nm, others, out.helps, brief, begun,
        stop, patience,
    )  # fmt: skip
    if out.ladder.ended:
        out.said.append(f"causes were looked for up to a point only: {out.ladder.ended}")
    if out.turned is not None:
        return out
    if out.kinked is not None:
        tell("break points where the data have theirs")
        start = as_in(start, out.kinked)
        return _climbed(
            clean, start, rng, tell, others, reading, patience, brief, told, True, better
        )
    if not repeated and better is None and out.ladder.steps:
        last = out.ladder.last.point
        if engine.noise_of(settled, last, rng)[0].spectrum.rms_um < LOUD * whitener.spectrum.rms_um:
            tell("noise beside a better model")
            return _climbed(
                clean, start, rng, tell, others, reading, patience, brief, told, kinked, last
            )
    if start.fixed and (right := put_right(
        space, first, out.error_nm(out.ladder.last), out.noise_nm, out.error_nm
    )) is not None:  # fmt: skip
        tell(f"with {right.cause} put right")
        out.monitored.append(right)
        # back at home: what it is off by there looks like many causes, and is none
        out.ladder = replace(out.ladder, first=right.fitted, steps=())
    if brief and out.ladder.steps:
        return out
    if not out.monitored or reading is None:
        return _at_their_reaches(out, tell)
    out.ladder = freed(space, out.ladder)
    if not out.ladder.steps:  # then the last rung is the monitor's
        out.monitored[-1] = replace(out.monitored[-1], fitted=out.ladder.first)
    other = corrected(space, out.ladder, reading)
    if other is None:
        return _at_their_reaches(out, tell)
    tell("without the monitor's delay")
    out = _climbed(
        clean, start, rng, tell, others, other[0], patience, told=told, kinked=kinked,
        better=better,
    )
    out.said = [*out.said, other[1]]
    return out


def _set_out(
    groups: Groups, whitener: CellWhitener, repeated: bool, start: Point,
    settled: Groups | None = None,
) -> Climbed:
    """The space of some recordings, and the baseline in it.

    ``settled`` : the recordings as their noise is known by, if others
    """
    space, folds = engine.space_of(groups, whitener, start.model)
    if start.fixed:
        space.own_um = own_um_of(start.model, groups)
    first, floor = refit(space, start), noise_floor_nm(settled or groups)
    kind = reported_kind(groups, folds)
    if folds == "cycles" and extrapolates(space):
        kind = "none"
    judged = kind
    if folds == "sweep" and not all_repeated(groups):
        judged = AGAIN
        if not spanned(space):
            kind = AGAIN if repeated else "none"
    return Climbed(space, folds, kind, floor, repeated, first, judged)


def _at_their_reaches(out: Climbed, tell: Callable[[str], None]) -> Climbed:
    tell("how far laws reach")
    if out.ladder.steps:
        *before, step = out.ladder.steps
        there = converged(out.space, step.fitted)
        if out.errors(there).rms_nm <= WORSE * out.errors(step.fitted).rms_nm:
            out.ladder = replace(out.ladder, steps=(*before, replace(step, fitted=there)))
    out.ladder, out.known = at_their_reaches(out.space, out.ladder, out.error_nm, out.known)
    out.spread = {
        name: as_held(*ci, logarithmic=name[1] == "reach")
        for known in out.known.values() for name, ci in known.intervals.items()
    }
    out.ladder = faded(out.space, out.ladder, tell)
    out.ladder = bends_first(out.space, out.ladder, out.error_nm, tell)
    out.ladder = in_order(out.space, out.ladder, out.error_nm, tell)
    last = out.ladder.last
    settle(out.space, last.point)
    if out.floor_nm is not None:
        once = [g.at_one_time(last.point.model) for g in out.space.groups.groups]
        out.floor_nm = noise_floor_nm(out.space.groups.with_(once))
    covariance = AS_HELD**2 * over_scales(last) + _between_samples(last, out.space)
    known = replace(last, covariance=covariance)
    if out.ladder.steps:
        *before, step = out.ladder.steps
        steps = (*before, replace(step, fitted=known))
        out.ladder = replace(out.ladder, steps=steps)
    else:
        out.ladder = replace(out.ladder, first=known)
    return out


def _between_samples(fitted: Fitted, space: Space) -> FloatArray:
    """Covariance (q, q) from what the drive may do between samples."""
    point, step_s = fitted.point, 1.0 / space.groups.rate
    own = {
        (stage.id, name): sd
        for stage in point.model.stages if isinstance(stage, Cause)
        for name, sd in stage.between_samples(step_s).items()
    }  # fmt: skip
    return np.diag([own.get(name, 0.0) ** 2 for name in point.names])
