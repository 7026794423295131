"""What a cause adds to a stage: how it would show, so that a diagnosis can look for it.

A diagnosis knows no cause by name. It plays the model with a small example of the stage and
without it; the differences are the cause's signatures. A new cause is found as soon as its file
says what small examples of it look like.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain.model import Model
from piezo_rig.chain.stage import Parameter, Signal, Stage

FloatArray = NDArray[np.float64]

TAPERS = (0.0, 1.0)  # how a law ends: all at once; little by little
FINER = np.linspace(-6.0, 6.0, 13)  # steps over the parameter that a cause wants scanned
APART, LONGEST = 1.5, 0.05  # of delays that are tried; the longest, of the time of a half loop
NEAR = 0.15  # share by which numbers may differ where columns made with others serve
NEAR_IN_TIME = 0.01  # of delays and modes: at 6 %, one of 80 us gained 60 by columns of 75 us
BENT = 1.1  # largest slew, of the mean of the fastest half loop; noise of a recorded drive is less
AT_BEST = 1e-4  # of a reading, that digitizers and amplifiers are good for; most say 0.03 to 0.1 %
NEAR_AT_A_LIMIT = 0.001  # of the drive: beyond it the drive is another one


@dataclass(frozen=True, eq=False)
class Context:
    """What the data are like, for examples of a plausible size.

    Attributes
    ----------
    model : the model that the cause would extend
    travel_um, span_v : largest travel and largest drive range of one recording
    slews_v_per_s : mean |dV/dt| of the half loops, shape (m,)
    step_s, duration_s : sampling step; longest recording
    seen_hz : samples per second at which effects are looked for
    offset_v : drive at no command, if it has any
    session_s : from the beginning of the first recording to the end of the last
    ends_v : lowest and highest drive
    ends_um : how far the sensor goes below (negative) and above where a sweep begins
    steepest_v_per_s : largest |dV/dt| within a half loop, over some samples
    noise_v : what was taken out of the drive
    cycles_before : most cycles that were played in recordings before one
    first_rises : whether any recording begins virgin and rises
    holds : whether the drive stops and stands still again and again
    corners : whether it mostly turns from one sample to the next
    repeated : whether repeats show the noise
    pauses : whether recordings carry on from others after a pause
    """

    model: Model
    travel_um: float
    span_v: float
    slews_v_per_s: FloatArray
    step_s: float
    duration_s: float
    seen_hz: float
    offset_v: float = 0.0
    session_s: float = 0.0
    ends_v: tuple[float, float] = (0.0, 0.0)
    ends_um: tuple[float, float] = (0.0, 0.0)
    steepest_v_per_s: float = 0.0
    noise_v: float = 0.0
    cycles_before: float = 0.0
    first_rises: bool = False
    holds: bool = False
    corners: bool = False
    repeated: bool = False
    pauses: bool = False

    @property
    def fastest_v_per_s(self) -> float:
        """The fastest half loop, or where half loops are plainly not straight what is steepest."""
        mean = float(self.slews_v_per_s.max(initial=0.0))
        return self.steepest_v_per_s if self.steepest_v_per_s > BENT * mean else mean

    @property
    def slew_v_per_s(self) -> float:
        """A typical slew rate while the drive moves."""
        return float(np.median(self.slews_v_per_s)) if self.slews_v_per_s.size else 1.0

    @property
    def several_speeds(self) -> bool:
        """Whether half loops differ in speed by a factor of 1.5, or the drive moves and stands."""
        if self.holds:
            return True
        slews = self.slews_v_per_s
        low, high = np.percentile(slews[slews > 0.02 * slews.max()], [5, 95])
        return bool(high > 1.5 * low)


class Cause(Stage):
    """A stage that a diagnosis can look for.

    Class attributes
    ----------------
    meanings : parameter -> what it is, in a few words for whoever reads a report
    priors : parameter -> (mean, standard deviation) for what data rarely fix: assumed laws
    limits : parameter -> (lowest, highest) that is physically possible
    largest : the largest plausible size, in units of the examples' own size; an effect that
        would not show at that size cannot be looked for in the data at hand
    beyond : log-likelihood by which it must be likelier than others to be taken before them: of so
        many numbers, under some drives, that it does what another one does by one
    law : what (in the words of a diagnosis' dictionary) a wrong form of its assumed law would
        depend on -> by which share of the effect's size each such term may be off
    given : parameters that come with the form of an example and are not fitted
    beside_one_curve : those that only a first rise by the same elements tells from the table: let
        go of with `also`, and held again once the first rise has elements of its own
    sharp : parameter -> by how much finer than its example it must be varied
    cuts_off : whether it cuts off what goes beyond a level: a large one is taken for a memoryless
        bend at a first look, and which one a small one is shows once they are refitted
    scanned : an optional parameter that is looked for over its logarithm, and by which factor at
        first; it has many local optima, or the data say little of it
    walked : a level that is looked for in the same way where its effect is large: the base has bent
        to what it took for something else, and no descent gets past that
    lasting : a parameter in seconds that may be far longer than a small example: what it does
        beside corners has another form then, and it is begun at several values
    whole : its examples are the effect itself, and not a small part of it
    near : share by which its numbers may differ where columns that were made with others serve
    kinked : a parameter in seconds whose effect has a kink at whole samples, where a descent hangs
    known_to : share of a level or a limit by which instruments agree at best: no interval of it
        is narrower
    bending : a level, beyond which a descent may begin better: elements bend to stay within it
    sized : parameters that its effect is proportional to, of a cause with `shapes`
    leaves : share of its effect that its law may leave, rms: none is known better
    loosened : optional parameters that let go of its assumed law, and the size of an example: they
        are fitted where the effect is so large that what is left of it shows
    brings_along : causes that look like what it still does of what went before a recording, where
        nobody knows that
    of_speed : it is told from the model's own loop by half loops that differ in speed, or just
        after a corner alone, where a loop stands still and it does not
    at_one_frequency : what its `law` leaves open as well where all half loops take the same time,
        of what then grows with how far they go
    at_corners : at one speed it shows there alone too, though no loop does the like
    like_no_other : what it does is like nothing that a model may get wrong: where it is plain,
        whatever else is wrong is no reason against it
    needs_first_rise : it can show only where the data hold a first rise from rest
    needs_known_order : it can be told only where every recording begins virgin, at a known time
    needs_fixed_model : a model that is refitted takes it in without a trace
    of_base : it belongs to the base model: found like a cause, never a finding or an alternative
    """

    meanings: ClassVar[Mapping[str, str]] = {}
    priors: ClassVar[Mapping[str, tuple[float, float]]] = {}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {}
    largest: ClassVar[float] = 30.0
    beyond: ClassVar[float] = 0.0
    law: ClassVar[Mapping[str, float]] = {}
    given: ClassVar[tuple[str, ...]] = ()
    beside_one_curve: ClassVar[tuple[str, ...]] = ()
    sharp: ClassVar[Mapping[str, float]] = {}
    sized: ClassVar[tuple[str, ...]] = ()
    scanned: ClassVar[tuple[str, float]] = ("", 1.0)
    walked: ClassVar[tuple[str, float]] = ("", 1.0)
    cuts_off: ClassVar[bool] = False
    lasting: ClassVar[str] = ""
    whole: ClassVar[bool] = False
    near: ClassVar[float] = NEAR
    kinked: ClassVar[str] = ""
    known_to: ClassVar[float] = 0.0
    bending: ClassVar[str] = ""
    loosened: ClassVar[Mapping[str, float]] = {}
    leaves: ClassVar[float] = 0.05
    brings_along: ClassVar[tuple[str, ...]] = ()
    of_speed: ClassVar[bool] = False
    at_one_frequency: ClassVar[Mapping[str, float]] = {}
    at_corners: ClassVar[bool] = False
    like_no_other: ClassVar[bool] = False
    needs_first_rise: ClassVar[bool] = False
    needs_known_order: ClassVar[bool] = False
    needs_fixed_model: ClassVar[bool] = False
    of_base: ClassVar[bool] = False

    @classmethod
    def trials(cls, context: Context) -> list[Stage]:
        """Small examples whose signatures span the cause's effect; empty: cannot be looked for."""
        return []

    @classmethod
    def variants(cls, context: Context) -> list[list[Stage]]:
        """Sets of examples for several forms of the effect; a diagnosis takes the best form."""
        trials = cls.trials(context)
        if cls.lasting:
            return _of_any_length(trials[0], cls.lasting, context)
        return [trials] if trials else []

    def also(self, context: Context) -> list[Stage]:
        """Itself, doing besides what it does not do yet; for a diagnosis that has found it."""
        return []

    def less(self) -> list[Stage]:
        """Itself, each without one of several things that it does."""
        return []

    @classmethod
    def finer(cls, trials: Sequence[Stage]) -> list[list[Stage]]:
        """Examples about the form that fitted best, of which a refit begins at the best.

        None for most causes; where there are many local optima the next one is to be the right one.
        """
        name, factor = cls.scanned
        if not all(name in t.parameters for t in trials):
            return []
        return [[t.with_values(**{name: t[name] * f}) for t in trials] for f in factor**FINER]

    @property
    def by_form(self) -> Mapping[str, float]:
        """Sizes that differ among laws which are as likely, and by what share of them (standard
        deviation), while a law is assumed.
        """
        return {}

    @property
    def assumed(self) -> Mapping[str, float]:
        """`law` of these numbers."""
        return self.law

    def late_s(self, um_per_v: float) -> float:
        """Seconds by which it delays a steady motion; infinite for what is no delay."""
        return abs(self[self.lasting]) if self.lasting else np.inf

    @property
    def as_late_s(self) -> float:
        """How long a delay may be, s, that is no more than what its law leaves open."""
        return 0.0

    @property
    def tapers(self) -> tuple[float, ...]:
        """Ways in which a law may end: see `TAPERS`."""
        return TAPERS

    def usual(self) -> Stage:
        """The same in the form and with the numbers that it has more often than not."""
        return self

    def otherwise(self) -> list[Stage]:
        """The same in other forms; a diagnosis takes one of those where it is plainly better."""
        return []

    def shapes(self) -> dict[str, list[Stage]]:
        """Laws of it that differ too much for a descent to lead from one to another, each with
        places where it may begin, `sized` as in this one.
        """
        return {}

    def at_large(self, near: Stage | None = None) -> list[Stage]:
        """Where else a very large one may begin: a linear look from none of it may mislead.

        ``near`` : the best of those; others about it then
        """
        return []

    @classmethod
    def begun(cls, trials: Sequence[Stage], shares: FloatArray) -> Stage:
        """A stage from the shares (k,) in which the examples were found."""
        values = {}
        for name in cls.units:
            rest = cls.neutral.get(name, 0.0)
            moved = [t[name] - rest for t in trials]
            values[name] = float(
                np.clip(
                    rest + float(np.dot(shares, moved)), *cls.limits.get(name, (-np.inf, np.inf))
                )
            )
        for name in cls.optional:
            if name in trials[0].parameters:
                values[name] = trials[0][name]
        return cls.of(None, **values)

    def reported(self, covariance: FloatArray) -> dict[str, Parameter]:
        """Parameters with their intervals, in the catalogue's terms.

        ``covariance`` : of the stage's parameters in the order of ``units``
        """
        out = {}
        for i, (name, p) in enumerate(self.parameters.items()):
            half = 1.96 * float(np.sqrt(max(covariance[i, i], 0.0)))
            interval = (p.value - half, p.value + half) if half > 0 else None
            out[name] = Parameter(p.value, p.unit, interval)
        return out

    def plausible(self, context: Context) -> bool:
        """Whether data of this kind tell these numbers from what looks the same."""
        return True

    @property
    def plain(self) -> bool:
        """Whether it is at its numbers unlike what other causes do: else they go before it, unless
        it is far likelier.
        """
        return True

    def between_samples(self, step_s: float) -> dict[str, float]:
        """Standard deviations of parameters from what the drive may do between samples.

        A generator that holds its samples moves in steps, a model takes straight lines.
        """
        return {}


def _of_any_length(example: Stage, name: str, context: Context) -> list[list[Stage]]:
    """Examples of a delay or a lag, from a small one to a good part of a half loop.

    A short one looks like a long one everywhere but beside corners, and there alone is it told
    from a loop that opens with speed.
    """
    shortest = example[name]
    longest = LONGEST * context.span_v / max(context.slew_v_per_s, 1e-9)
    tried, next_s = [shortest], max(0.5 * context.step_s, APART * shortest)
    while next_s < longest:
        tried.append(next_s)
        next_s *= APART
    return [[example.with_values(**{name: float(seconds)})] for seconds in tried]


def added_by(stage: Stage, time_s: FloatArray, drive_v: FloatArray) -> FloatArray:
    """What a clock-locked stage adds to the displacement, um, shape (n,)."""
    nothing = np.zeros(time_s.size)
    return stage.act(Signal(time_s, drive_v, nothing)).displacement_um
