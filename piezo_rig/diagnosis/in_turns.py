"""Recordings cleaned and the ladder climbed, in turns: each shows what the other had hidden.

What is wrong with the recordings themselves is sought first, beside the baseline. A better model
leaves less, and what the baseline had hidden is sought once more beside it: lost samples that a
clock had stood for, another number of them, a hum, where a recording stands on the
interferometer's scale.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.causes.clock_ratio import ClockRatio
from piezo_rig.chain import Model
from piezo_rig.chain.bend import Bend
from piezo_rig.diagnosis.abreast import both
from piezo_rig.diagnosis.between import turn_between
from piezo_rig.diagnosis.climbed import PERIODIC, Climbed, climbed, fitted_anew
from piezo_rig.diagnosis.early import (
    HUM,
    TRIED,
    Break,
    Early,
    Reading,
    clean_up,
    credited,
    hum_again,
    hum_behind,
    losses_of_monitors,
    never_outliers,
    read_monitor,
    with_monitors_mended,
)
from piezo_rig.diagnosis.early.mended import DROP, JUMP
from piezo_rig.diagnosis.early.recounted import BESIDE_ALL, PLAINLY, square_of
from piezo_rig.diagnosis.engine import plainly, with_its_bend
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.found import RIPPLE
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.left_creeping import less_what_creeps_on
from piezo_rig.diagnosis.patience import Patience
from piezo_rig.diagnosis.refit import Fitted
from piezo_rig.diagnosis.refusals import FITS
from piezo_rig.diagnosis.ripples import AnyRipple, Aside, set_aside, without
from piezo_rig.diagnosis.scale import at_one_phase, read_anew
from piezo_rig.diagnosis.scan import LEVEL
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]
SHARE = 0.2  # of the false alarms that a search of the raw recordings may take
READ_ANEW = 2  # times
FAR_OFF = 3.0  # times the noise
MUCH = 50.0  # log-likelihood by which recordings have changed so that others may be found in them
DIFFER = 0.6745 * np.sqrt(2.0)  # of the noise, by which half of all samples differ from the next


class TurnsBetween(Exception):
    """The drive turns between samples, as a model has it: all that was fitted begins anew."""

    def __init__(self, model: Model) -> None:
        super().__init__()
        self.model = model


@dataclass(eq=False)
class InTurns:
    """Recordings as clean as they have become, and the ladder that was climbed on them.

    Attributes
    ----------
    raw, sweeps : recordings as they were made
    start : the baseline, fitted to what is clean by now
    between : whether the drive is known to turn between samples
    lost : samples that drive monitors show to be lost
    early : what was found wrong with the recordings themselves, in order
    aside : an error that comes back with displacement or drive at a period of its own, if any
    whole, clean : without all that; with repeats also at one phase of the interferometer's error
    reading : of the drive monitor
    patience : how much was tried by now
    """

    raw: Groups
    sweeps: Sequence[Sweep]
    start: Fitted
    rng: np.random.Generator
    tell: Callable[[str], None]
    between: bool
    lost: list[Break] = field(default_factory=list)
    early: list[Early] = field(default_factory=list)
    aside: AnyRipple | None = None
    reading: Reading | None = None
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    patience: Patience = field(default_factory=Patience)
    whole: Groups = field(init=False)
    clean: Groups = field(init=False)
    search: Climbed = field(init=False)

    @property
    def tried(self) -> int:
        """Causes in the race, for the correction."""
        return sum(1 for k in CAUSES.values() if issubclass(k, Cause))

    @property
    def cleaned(self) -> list[tuple[str, Groups]]:
        """The recordings as they were made, then what was taken off, with what that left."""
        off = [("", self.raw), *((f.cause, f.groups) for f in self.early)]
        return off if self.aside is None else [*off, (RIPPLE, self.clean)]

    @property
    def hums(self) -> bool:
        """Whether a hum was found beside the baseline or a model, after all else."""
        return bool(self.early) and self.early[-1].cause == HUM

    @property
    def alone(self) -> set[int]:
        """Groups of one recording each."""
        return {k for k, g in enumerate(self.clean.groups) if g.repeats < 2}

    def go(self) -> None:
        """All of it.

        Raises
        ------
        TurnsBetween : unless that is known
        """
        self._begin()
        heard = self.hums
        self._climb(brief=heard)
        while self._other_losses():
            heard = self.hums
            self._climb(brief=heard)
        if self._never_outliers():
            self._climb()
        if self.search.ladder.steps:
            if heard:
                self._hum_again()
            else:
                self._hum_behind()
        weary = self.patience.lost
        if turn_between(self.search.space, self.search.ladder.last, weary=weary):
            raise TurnsBetween(self.search.ladder.last.point.model)
        self._phases_anew()
        self._less_what_creeps_on()

    def _begin(self) -> None:
        """What the recordings show by themselves, beside the baseline."""
        self.tell("outliers, jumps, lost samples and hum")

        self.lost = losses_of_monitors(self.raw, self.sweeps)
        heard_of = with_monitors_mended(self.sweeps, self.raw, self.lost)

        def heard() -> Reading | None:
            return read_monitor(self.raw, heard_of, SHARE * LEVEL, self.tried)

        beside = with_its_bend(self.raw, self.start.point)
        # neither asks for what the other says: the monitor hears nothing of what the sensor does
        (self.early, point), self.reading = both(
            self.start.space, lambda: self._cleaned(beside), heard,
            [self.raw, *self.start.parts, beside],
        )  # fmt: skip
        if self.reading is not None and self.reading.between and not self.between:
            model = self.start.point.model
            for seen in self.reading.told:
                model = model.with_stage(seen.stage)
            raise TurnsBetween(model)
        self.whole = self.raw
        if self.early:
            self.whole = self.early[-1].groups
            self.start = plainly(self.whole, point.without(Bend.id))
            beside = with_its_bend(self.whole, self.start.point)
        base = self.start.point
        found, self.clean = both(
            self.start.space, lambda: self._to_set_aside(beside),
            lambda: at_one_phase(self.whole, base.model), [self.whole, *self.start.parts],
        )  # fmt: skip
        if found is not None:
            self.aside, self.whole = found.ripple, found.groups
            self.start = plainly(self.whole, base)
            self.clean = at_one_phase(self.whole, self.start.point.model)
        if self.clean is not self.whole:
            self.notes.append(
                "the interferometer's periodic error has another phase in every recording: "
                "repeats are turned to that of the first"
            )
            self.start = plainly(self.clean, self.start.point)
        if self.reading is not None:
            self.notes += self.reading.notes
            self.warnings += self.reading.warnings

    def _to_set_aside(self, base: Point) -> Aside | None:
        """An error that comes back with displacement or drive, and has no name; None without."""
        return set_aside(
            self.whole, base, lambda groups, p: plainly(groups, p).point,
            SHARE * LEVEL / self.tried,
        )  # fmt: skip

    def _without(self, groups: Groups, model: Model) -> Groups:
        """Recordings less what was set aside."""
        return groups if self.aside is None else without(groups, model, self.aside)

    def _cleaned(
        self, beside: Point | None = None, behind: float | None = None, enough: float = PLAINLY
    ) -> tuple[list[Early], Point]:
        return clean_up(
            self.raw, self.sweeps, beside or self.start.point,
            _plainly, SHARE * LEVEL, self.tried, behind, enough, self.lost,
        )  # fmt: skip

    def _climb(self, brief: bool = False) -> None:
        self.search = climbed(
            self.clean, self.start.point, self.rng, self.tell, len(TRIED), self.reading,
            brief=brief, patience=self.patience,
        )
        if self.search.turned is not None:
            raise TurnsBetween(self.search.turned)

    def _other_losses(self) -> bool:
        """Whether other samples are lost than those that the baseline had shown, or jumps are there
        that it hid.
        """
        alone, clock = self.alone, self._like_a_clock()
        steps = [*self.search.monitored, *self.search.ladder.steps]
        if not (steps or clock) or not alone:
            return False
        model = base = self.search.ladder.last.point
        left = square_of(self.clean, model, alone)
        for step in steps:
            base = base.without(step.cause)
        known, others = credited(self.early), False
        if clock:
            self.tell("lost samples behind what looks like a clock")
            # where some are lost, a lag among what was found hides a part of others from the base
            fuller = [model.without(ClockRatio.id)] if known[0] and len(steps) > 1 else []
            for beside in (*fuller, base):
                behind, there = self._cleaned(beside, left)
                others = credited(behind) > known or self._never_lost(behind, there, left)
                if others:
                    break
            for step in steps:
                there = there.without(step.cause)
            base = there if others else base
        if known[0] and not others and not self.lost:
            self.tell("lost samples counted once more")
            behind, there = self._cleaned(model, enough=BESIDE_ALL)
            mended = behind[-1].groups if behind else self.raw
            others = credited(behind)[0] != known[0] and (
                square_of(mended, plainly(mended, there).point, alone) < BESIDE_ALL * left
            )
        elif not clock and _far_off(self.clean, model, alone):
            self.tell("jumps and lost samples beside a better model")
            behind, there = self._cleaned(model)
            mended = behind[-1].groups if behind else self.raw
            others = _breaks(behind) > _breaks(self.early) and (
                square_of(mended, plainly(mended, there).point, alone) < BESIDE_ALL * left
            )
        if others:
            self._begin_anew(behind, base)
        return others

    def _like_a_clock(self) -> bool:
        """Whether a clock was found, or fits these data and predicts others worse: losses in
        one of several recordings look like that.
        """
        ladder = self.search.ladder
        why = ladder.scans[-1].refused.get(ClockRatio.id, "") if ladder.scans else ""
        return why.startswith(FITS) or any(
            s.cause == ClockRatio.id for s in [*self.search.monitored, *ladder.steps]
        )

    def _never_lost(self, found: list[Early], there: Point, left: float) -> bool:
        """Whether fewer samples are lost than the baseline had shown, for what is found beside a
        model that has no clock leaves less than losses and a clock that makes up for them.
        """
        if not credited(found)[0] < credited(self.early)[0]:
            return False
        mended = found[-1].groups if found else self.raw
        return square_of(mended, plainly(mended, there).point, self.alone) < left

    def _begin_anew(self, early: list[Early], base: Point) -> None:
        """With other things wrong with the recordings than the baseline had shown."""
        self.early = early
        self.whole = self._without(early[-1].groups if early else self.raw, base.model)
        self.clean = at_one_phase(self.whole, plainly(self.whole, base).point.model)
        self.start = plainly(self.clean, base)

    def _never_outliers(self) -> bool:
        """Whether what the baseline left looked like outliers, and there are none beside a model.
        """
        steps = [*self.search.monitored, *self.search.ladder.steps]
        if not steps:
            return False
        base = self.search.ladder.last.point
        others = never_outliers(self.raw, self.early, base.model)
        if others is None:
            return False
        self.tell("what looked like outliers")
        for step in steps:
            base = base.without(step.cause)
        self._begin_anew(others, base)
        return True

    def _hum_behind(self) -> None:
        """Hum that what the baseline leaves had hidden."""
        late = hum_behind(
            self.clean, self.search.ladder.last.point, _base_anew, SHARE * LEVEL, self.tried
        )
        if late is None:
            return
        self.tell("hum")
        self.early.append(late)
        self.whole = self.clean = late.groups
        self.start = plainly(self.clean, self.start.point)
        self._climb()

    def _hum_again(self) -> None:
        """Hum was fitted to what the baseline left; most of that has an explanation now."""
        self.tell("hum once more")
        last, hum = self.search.ladder.last.point, self.early.pop()
        better = last.model
        self.whole = self.early[-1].groups if self.early else self.raw
        again = hum_again(self.whole, hum, last, _base_anew, SHARE * LEVEL, self.tried)
        if again is not None:
            self.early.append(again)
            self.whole = again.groups
        self.whole = self._without(self.whole, better)
        self.clean = at_one_phase(self.whole, better.without(PERIODIC))
        self.start = plainly(self.clean, self.start.point)
        self._climb()

    def _less_what_creeps_on(self) -> None:
        """What creep of the recordings before still does in one is taken off, and the ladder fitted
        anew; climbed anew where that is much, or the drive monitor's.
        """
        last = self.search.ladder.last
        found = less_what_creeps_on(last, self.clean)
        if found is None:
            return
        self.tell("recordings without what creeps on from those before")
        self.clean = found.groups
        self.notes.append("creep goes on from one recording to the next: what it leaves in them, "
                          "by the times at which they begin, is taken off")  # fmt: skip
        if self.search.monitored or found.fitted.evidence > last.evidence + MUCH:
            self._climb()
        else:
            self.search = fitted_anew(self.search, found.fitted, self.tell)

    def _phases_anew(self) -> None:
        """Phases were read beside all that the baseline leaves; most of that is explained now."""
        for _ in range(READ_ANEW):
            better = self.search.ladder.last.point.model
            if better.stage(PERIODIC) is None:
                return
            anew = read_anew(self.whole, self.search.space.groups, better.without(PERIODIC))
            if anew is None:
                return
            self.tell("where recordings stand on the interferometer's scale")
            self.clean = anew
            self._climb()


def _plainly(groups: Groups, point: Point) -> Point:
    return plainly(groups, point).point


def _base_anew(groups: Groups, point: Point) -> Point:
    """A model with its elements fitted to other recordings, and all else of it as it is."""
    base = plainly(groups, replace(point, sizes=())).point
    return replace(base, sizes=point.sizes)


def _breaks(found: Sequence[Early]) -> int:
    """How many jumps and losses there are."""
    return sum(len(early.events) for early in found if early.cause in (JUMP, DROP))


def _far_off(groups: Groups, point: Point, members: set[int]) -> bool:
    """Whether far more is left of some groups than what their samples differ by from one to the
    next.
    """
    samples, differences = 0, list[FloatArray]()
    for g in (groups.groups[k] for k in members):
        left = g.measured_um - g.predicted(point.model)
        differences += [np.abs(np.diff(left[:, a:b])).ravel() for a, b in g.blocks]
        samples += sum(g.repeats * (b - a) for a, b in g.blocks)
    noise = float(np.median(np.concatenate(differences))) / DIFFER
    return square_of(groups, point, members) > samples * (FAR_OFF * noise) ** 2
