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
so little by little. With 2 the state is the mean of stops of every width up to three times the
reach, as of many walls, with 3 of widths that are distributed like exp(-width/reach): it is gained
fast and given back with a long tail.

The state begins in its middle, or, with ``from_below`` 1, at its lower end, as if the first rise
were one of many. Whether a first rise from rest has anything of it at all is assumed.

Shows as: a difference between half loops right after the turning point that
follows the direction and nothing else.

Remedy: Use the saved model for both directions, or approach every position from the same side.

Plausible: ratios of 0.9 to 1.1.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import GIVEN, REACHING, SCANNED, TAPERS, Cause, Context, forms, reaching
from piezo_rig.chain.branches import Branches, FloatArray
from piezo_rig.chain.half_loops import HalfLoops
from piezo_rig.chain.increments import Increment, Operation
from piezo_rig.chain.stage import Signal, Stage
from piezo_rig.errors import InputError

WIDTHS: tuple[FloatArray, ...] = (  # of the stops, in reaches, taper by taper
    np.array([1.0]), np.array([2.0]), np.linspace(3.0 / 16.0, 3.0 - 3.0 / 16.0, 8),
    -np.log1p(-np.linspace(1.0 / 16.0, 15.0 / 16.0, 8)),
)  # fmt: skip
TAILS = (2.0, 3.0)  # tapers with a long tail


class DirectionAsymmetry(Cause):
    """``ratio`` of the first slopes, ascending over descending."""

    id = "direction-asymmetry"
    place = "actuator"
    together = True
    law: ClassVar[Mapping[str, float]] = {
        "direction": 0.1, "drive+direction": 0.1, "first rise": 0.25,
    }  # fmt: skip
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
        return (*TAPERS, *TAILS) if self.closes else super().tapers

    @property
    def from_below(self) -> bool:
        """Whether the state begins at its lower end."""
        return "from_below" in self.parameters and self["from_below"] > 0

    @property
    def state(self) -> tuple[FloatArray, float, bool]:
        """Widths of the stops to either side, um; share of the compliance at their ends; whether
        the share fades between them, or turns in the middle.
        """
        taper = self["taper"] if "taper" in self.parameters else 0.0
        share = (1.0 - self["ratio"]) / (1.0 + self["ratio"])
        return np.asarray(WIDTHS[int(taper)] * self["reach"]), share, taper > 0

    def act(self, signal: Signal) -> Signal:
        if not self.closes:
            return signal
        from piezo_rig.chain.stops import stopped_each

        widths, share, fades = self.state
        x = np.ascontiguousarray(signal.displacement_um)
        stop = stopped_each(signal.begins, x, widths, -1.0 if self.from_below else 0.0)
        return signal.with_displacement(
            x - share * (stop * stop / (2.0 * widths.mean()) if fades else np.abs(stop))
        )

    def otherwise(self) -> list[Stage]:
        """Begun elsewhere."""
        return [self.with_values(from_below=0.0 if self.from_below else 1.0)] if self.closes else []

    def increment(self, branches: Branches) -> Increment | str:
        if not self.closes:
            return Increment(Operation.GAIN, (1.0, 0.0))
        widths, share, fades = self.state
        return Increment(
            Operation.STOP,
            (share, float(fades), -float(self.from_below), float(widths.size),
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
                *forms(context, (0.0,)), *forms(context, (1.0,), TAILS[:1]),
                *(f | {"from_below": 1.0} for f in forms(context, (1.0,), TAILS[:1])),
            ]
        ]  # fmt: skip
