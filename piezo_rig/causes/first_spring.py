"""Laws of the first spring: what the causes have in common whose spring follows the history."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes.cause import TAPERS, Cause, Context
from piezo_rig.chain.branches import Branches, Law, Reaching
from piezo_rig.chain.half_loops import HalfLoops
from piezo_rig.chain.increments import Increment
from piezo_rig.chain.stage import Stage

if TYPE_CHECKING:
    from piezo_rig.chain.held_force import Springs

FloatArray = NDArray[np.float64]
REACHING: Mapping[str, str] = {"reach": "um", "closing": "1", "taper": "1"}
HOLDING: Mapping[str, str] = {"carries": "1", "spring": "V/um", "at_force": "1", "from_rest": "1"}
GIVEN = ("closing", "taper")
OF_TWO_TURNS: Mapping[str, float] = {"range": 0.1, "direction": 0.1}  # that a law leaves open
STEEP = 0.2  # of the mean spring constant, by the whole range of the drive: begins of a large law
REACHED = (0.014, 0.02, 0.03, 0.04)  # of the travel
LEAST = 1e-3  # of a spring's own stiffness, that a law leaves of it
SCANNED = ("reach", 2.0**0.125)


class FirstSpring(Cause):
    """A spring right after the turning point that follows the input's history, as in the thesis.

    k_1 = slope x history + offset (thesis eq. 7-10); the subclass says which history. Without a
    ``reach`` the law is that of the table's own first element, which gives way at the same
    displacement whatever its spring constant. With one, it is a spring of its own that holds up
    to that displacement after every turning point.
    """

    place = "actuator"
    meanings: ClassVar[Mapping[str, str]] = {
        "slope": "stiffness just after a turning point, by volt of what it follows",
        "offset": "the part of it that follows nothing",
        "reach": "displacement after a turning point up to which it acts",
        "closing": "1: what it adds is taken back until twice the reach; 0: it is not",
        "taper": "1: it fades out until twice the reach; 0: it ends there",
        "carries": "1: its spring keeps its force over a turning point; 0: it begins anew",
        "spring": "stiffness of the spring in whose place it stands",
        "at_force": "1: it gives way at a force; 0: at a displacement, whatever its stiffness",
        "from_rest": "1: a first rise follows it as well; 0: it does not",
    }
    units: ClassVar[Mapping[str, str]] = {"slope": "V/um/V", "offset": "V/um"}
    optional: ClassVar[Mapping[str, str]] = REACHING
    given: ClassVar[tuple[str, ...]] = GIVEN
    beside_one_curve: ClassVar[tuple[str, ...]] = ("offset",)
    scanned: ClassVar[tuple[str, float]] = SCANNED
    closings: ClassVar[tuple[float, ...]] = (0.0,)
    like_speed: ClassVar[bool] = False  # whether what it follows grows with how fast half loops are
    leaves: ClassVar[float] = 0.5  # as the law fades out so does an actuator, but for its shape
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"reach": (1e-6, np.inf)}

    @staticmethod
    def history(loops: HalfLoops) -> FloatArray:
        """Volts for every half loop, shape (loops,)."""
        raise TypeError("a subclass says which history")

    @property
    def assumed(self) -> Mapping[str, float]:
        """One that keeps its force hangs on two turning points, and so on the range between them.

        Over loops that begin at one voltage a law of the extremum is then one of the range.
        """
        carries = "carries" in self.parameters and self["carries"] > 0
        return {**OF_TWO_TURNS, **self.law} if carries else self.law

    @property
    def holds_force(self) -> bool:
        """Whether it is the law of a spring with a slider, which knows its own force."""
        return "spring" in self.parameters

    @property
    def tapers(self) -> tuple[float, ...]:
        return (0.0,) if self.holds_force else super().tapers

    def springs(self, loops: HalfLoops, begins: NDArray[np.int64]) -> Springs:
        from piezo_rig.chain.held_force import Springs

        plain, half = self["spring"], 0.5 * self["reach"]
        rises, history = np.isin(loops.start, begins), self.history(loops)
        if self.like_speed:
            history = np.where(rises, 0.0, history)  # there is no half loop before a first rise
        stiffness = np.maximum(self["slope"] * history + self["offset"], LEAST * plain)
        if not self["from_rest"]:
            stiffness[rises] = plain
        gives_way = plain * half * np.ones(len(loops)) if self["at_force"] else stiffness * half
        return Springs(loops.start, stiffness, gives_way, plain, plain * half)

    def increment(self, branches: Branches) -> Increment | str:
        """Asked only where it keeps its force."""
        return "the force that its spring keeps is not followed sample by sample"

    def shape(self, branches: Branches) -> Branches:
        if self.holds_force:
            return branches

        def law(slopes: FloatArray, loops: HalfLoops) -> FloatArray:
            return slopes + self["slope"] * self.history(loops) + self["offset"]

        return reaching(self, branches, law)

    def also(self, context: Context) -> list[Stage]:
        """With its constant part, which is the table's own but for a first rise that follows it."""
        if self["offset"] != 0.0 or not (context.first_rises and context.model.one_curve):
            return []
        return [self.with_values(offset=0.01 * context.span_v / context.travel_um)]

    def otherwise(self) -> list[Stage]:
        """With the spring's force carried over turning points, or without; see `Reaching`."""
        if "carries" not in self.optional or "reach" not in self.parameters or self.holds_force:
            return []
        carries = "carries" in self.parameters and self["carries"] > 0
        return [self.with_values(carries=float(not carries), closing=0.0)]

    @classmethod
    def at_its_size(cls, travel_um: float, mean_v: float) -> list[Stage]:
        """Begins of a large one, about the mean of what it follows, up to some shorter reaches.

        Least squares goes from there to either sign.
        """
        slope = STEEP / travel_um
        return [
            cls.of(None, slope=slope, offset=-slope * mean_v, reach=share * travel_um,
                   closing=0.0, taper=0.0)
            for share in REACHED
        ]  # fmt: skip

    @classmethod
    def closings_in(cls, context: Context) -> tuple[float, ...]:
        """Of the forms that are looked for."""
        return cls.closings

    @classmethod
    def variants(cls, context: Context) -> list[list[Stage]]:
        size = 0.01 * context.span_v / context.travel_um
        every = forms(context, cls.closings_in(context))
        if "carries" in cls.optional:
            every += [f | {"carries": 1.0} for f in forms(context, (0.0,), (0.0,))]
        return [
            [cls.of(None, slope=size / context.span_v, offset=0.0, **form)] for form in every
        ]


def forms(
    context: Context, closings: Sequence[float], tapers: Sequence[float] = TAPERS
) -> list[dict[str, float]]:
    """How far after a turning point a law may hold, and how it may end."""
    return [
        {"reach": share * context.travel_um, "closing": closing, "taper": taper}
        for share in (0.01, 0.02, 0.04, 0.08, 0.16)
        for closing in closings
        for taper in tapers
    ]


def reaching(stage: Stage, branches: Branches, law: Law) -> Branches:
    """A law on the first element, or up to the stage's own ``reach`` where it has one."""
    if "reach" in stage.parameters:
        closing = stage["closing"] if "closing" in stage.parameters else 0.0
        tapered = "taper" in stage.parameters and stage["taper"] > 0
        carries = "carries" in stage.parameters and stage["carries"] > 0
        own = Reaching(stage["reach"], law, closing, tapered, carries)
        return replace(branches, reaching=(*branches.reaching, own))
    return replace(branches, laws=(*branches.laws, law))
