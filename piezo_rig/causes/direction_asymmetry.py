"""Direction asymmetry: ascending and descending half loops differ in shape.

Physics: switching with the poling direction and against it are not mirror
images. Thesis section 2.3, figure 2-3: ascending half loops begin steeper
than descending ones; chapter 5 leaves the model of it to future work. Here
the first slope is multiplied by 2r/(1+r) on ascending half loops and by
2/(1+r) on descending ones, so that their mean stays.

As a law of the first spring it lets loops gain on every turn. A stack's do not: it closes a loop
of half a volt as it closes one of 75 V. With ``closing`` 1 the asymmetry is therefore a function
of a state: even in the stop operator of the displacement, at whose two ends the two kinds of half
loop begin (a function of hysteresis operators closes what they close; K. Kuhnen, Eur. J. Control 9
(2003) 407, makes his asymmetric operator so). What a half loop gains up to the ``reach`` it gives
back until twice that, and what a smaller loop gains it gives back itself. With ``taper`` 1 it does
so little by little. With 2 the state is the mean of stops of many widths, as of many walls, so that
what is gained and given back is nearly x exp(-x^2 / 2 reach^2) of what a half loop has moved; with
3 they are distributed like exp(-width/reach): it is given back with a longer tail; with 4 like
width exp(-2 width/reach), which is between the two. With 5 it is given back little by little until
the half loop is where the one before it began, however far that is: what is gained goes like
reach (1 - exp(-x / reach)) (1 - x / whole). Memory is that of turning points, and a first rise
has nothing of it.

The state begins in its middle, or, with ``from_below`` 1, at its lower end, as if the first rise
were one of many, or, with -1, at its upper end: then a first rise from rest has nothing of it.

Shows as: a difference between half loops right after the turning point that
follows the direction and nothing else.

Remedy: Use the saved model for both directions, or approach every position from the same side.

Plausible: ratios of 0.9 to 1.1.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import TAPERS, Cause, Context
from piezo_rig.causes.first_spring import GIVEN, REACHING, SCANNED, forms, reaching
from piezo_rig.chain.branches import Branches, FloatArray
from piezo_rig.chain.half_loops import HalfLoops
from piezo_rig.chain.increments import Increment, Operation
from piezo_rig.chain.stage import Signal, Stage
from piezo_rig.errors import InputError

QUANTILES = (np.arange(48) + 0.5) / 48  # with few the tail ends in a corner, which no bell has


def _of_a_bell(quantiles: FloatArray) -> FloatArray:
    """Half widths, in the peak's distance, of stops whose mean's even part is a bell.

    For 1 - m^2 = g with g = x exp((1 - x^2) / 2) the mean has to rise like m' = -g'/2m behind the
    peak, at x = 1, and in front of it as fast as there: no stops rise slower first.
    """
    x = np.linspace(1.001, 7.0, 6000)
    g = x * np.exp(0.5 * (1.0 - x * x))
    still_moving = g * (x - 1.0 / x) / (2.0 * np.sqrt(1.0 - g))
    return np.asarray(0.5 * np.interp(quantiles, 1.0 - still_moving, x))


def _of_second_order(quantiles: FloatArray) -> FloatArray:
    """Half widths whose density is 4 w exp(-2 w), of mean 1: between the two others."""
    y = np.linspace(0.0, 20.0, 20001)
    return np.asarray(0.5 * np.interp(quantiles, 1.0 - (1.0 + y) * np.exp(-y), y))


WIDTHS: tuple[FloatArray, ...] = (  # of the stops, in reaches, taper by taper
    np.array([1.0]), np.array([2.0]), _of_a_bell(QUANTILES), -np.log1p(-QUANTILES),
    _of_second_order(QUANTILES),
)
TAILS = (2.0, 3.0, 4.0)  # tapers with a long tail
UNTIL_BACK = 5.0  # the taper of what is given back until where the half loop before began


class DirectionAsymmetry(Cause):
    """``ratio`` of the first slopes, ascending over descending."""

    id = "direction-asymmetry"
    place = "actuator"
    together = True
    law: ClassVar[Mapping[str, float]] = {
        "direction": 0.1, "drive+direction": 0.1, "first rise": 0.25,
    }  # fmt: skip
    meanings: ClassVar[Mapping[str, str]] = {
        "ratio": "stiffness just after a turning point, upwards over downwards",
        "reach": "displacement after a turning point up to which it acts",
        "closing": "1: what it adds is taken back until twice the reach; 0: it is not",
        "taper": "0: it ends there; 1 to 4: it fades out; 5: it is given back instead",
        "from_below": "where its state begins, from -1, the upper end, to 1, the lower one",
    }
    units: ClassVar[Mapping[str, str]] = {"ratio": "1"}
    neutral: ClassVar[Mapping[str, float]] = {"ratio": 1.0}
    optional: ClassVar[Mapping[str, str]] = {**REACHING, "from_below": "1"}
    given: ClassVar[tuple[str, ...]] = (*GIVEN, "from_below")
    rate_free = True
    scanned: ClassVar[tuple[str, float]] = SCANNED
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {
        "ratio": (0.2, 5.0),
        "reach": (1e-6, np.inf),
    }

    @property
    def passes(self) -> bool:
        """But for a share of (1 - r)/(1 + r)."""
        return True

    @property
    def closes(self) -> bool:
        """Whether it is a function of a state, and no law of the first spring."""
        return "closing" in self.parameters and self["closing"] >= 1.0

    @property
    def assumed(self) -> Mapping[str, float]:
        """A state has many forms, and on a first rise it may be twice what it is elsewhere."""
        if not self.closes:
            return self.law
        return {"direction": 0.15, "drive+direction": 0.15, "first rise": 2.0}

    @property
    def tapers(self) -> tuple[float, ...]:
        return (*TAPERS, *TAILS, UNTIL_BACK) if self.closes else super().tapers

    @property
    def begun_at(self) -> float:
        """Where the state begins, of its width: -1 at its lower end, 0 in its middle, 1."""
        return -self["from_below"] if "from_below" in self.parameters else 0.0

    @property
    def until_back(self) -> bool:
        """Whether it is given back until where the half loop before began."""
        return "taper" in self.parameters and self["taper"] == UNTIL_BACK

    @property
    def share(self) -> float:
        """Of the compliance right after a turning point: more of it upwards, less downwards."""
        return (1.0 - self["ratio"]) / (1.0 + self["ratio"])

    @property
    def state(self) -> tuple[FloatArray, float, bool]:
        """Widths of the stops to either side, um; share of the compliance at their ends; whether
        the share fades between them, or turns in the middle.
        """
        taper = self["taper"] if "taper" in self.parameters else 0.0
        return np.asarray(WIDTHS[int(taper)] * self["reach"]), self.share, taper > 0

    def act(self, signal: Signal) -> Signal:
        if not self.closes:
            return signal
        from piezo_rig.chain.stops import stopped_each

        x = np.ascontiguousarray(signal.displacement_um)
        if self.until_back:
            from piezo_rig.chain.given_back import given_back_each

            return signal.with_displacement(
                x + self.share * given_back_each(signal.begins, x, self["reach"])
            )
        widths, share, fades = self.state
        stop = stopped_each(signal.begins, x, widths, self.begun_at)
        return signal.with_displacement(
            x - share * (stop * stop / (2.0 * widths.mean()) if fades else np.abs(stop))
        )

    def otherwise(self) -> list[Stage]:
        """Begun elsewhere; what does not begin anywhere, with a tail that does."""
        if not self.closes:
            return []
        if self.until_back:
            return [self.with_values(taper=TAILS[0], from_below=x) for x in (1.0, -1.0)]
        others = [x for x in (0.0, 1.0, -1.0) if x != -self.begun_at]
        return [self.with_values(from_below=x) for x in others]

    def increment(self, branches: Branches) -> Increment | str:
        if not self.closes:
            return Increment(Operation.GAIN, (1.0, 0.0))
        if self.until_back:
            return Increment(Operation.GIVE_BACK, (self.share, self["reach"]))
        widths, share, fades = self.state
        return Increment(
            Operation.STOP,
            (share, float(fades), self.begun_at, float(widths.size),
             *map(float, widths)),
        )  # fmt: skip

    def shape(self, branches: Branches) -> Branches:
        if self.closes:
            return branches
        r = self["ratio"]

        def law(slopes: FloatArray, loops: HalfLoops) -> FloatArray:
            return slopes * np.where(loops.direction > 0, 2 * r, 2.0) / (1 + r)

        return reaching(self, branches, law)

    def check(self) -> None:
        super().check()
        if not self["ratio"] > 0:
            raise InputError(
                "model-stage",
                f"stage {self.id}: a ratio of {self['ratio']:g} is not above 0",
                "one direction would move without drive",
                "identify the model again",
            )

    @classmethod
    def variants(cls, context: Context) -> list[list[Stage]]:
        return [
            [cls.of(None, ratio=1.01, **form)]
            for form in [
                *forms(context, (0.0,)), *forms(context, (1.0,), (UNTIL_BACK,)),
                *(f | {"from_below": x} for x in (-1.0, 1.0)
                  for f in forms(context, (1.0,), TAILS[:1])),
            ]
        ]  # fmt: skip
