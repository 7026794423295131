"""Range dependence: the first spring follows the range of the most recent half loop.

Physics: how many domains take part right after a reversal depends on how far
the field has just travelled. Thesis section 3.1(a), eq. 7-8:
k_1 = slope x F_range + offset, with the displacement at which the first
element gives way unchanged, so that f_1 = k_1 dx.

Shows as: half loops that differ right after the turning point, in order of
the range before them. At one fixed frequency the slew rate is proportional to
the range, so rate dependence looks much the same.

A spring that becomes another one at a turning point may keep its force there, as springs and
sliders do (``carries`` 1): it is turned round from what the half loop before has left in it. By the
branches of the thesis it begins anew (0). For small changes it reaches as far as before; as it is,
with the whole stiffness k_1 in the law and a ``spring`` in whose place it stands, it gives way
after (k_before + k_now) dx / k_now, or at a force that stays.

What a half loop gains by it may stay (``closing`` 0), or be given back until twice the ``reach``
(1), so that it ends where it would have.

What becomes of a loop that the drive closes exactly, and not beyond, no law says: forgotten
(``ties`` 0), or its older branch taken up again further on (1). With a law it shows.

Remedy: Nothing is broken: use the saved model, which knows it, in place of the classical one.

Plausible: thesis, 7.5e-3 V/um per V and -0.36 V/um, against a first slope near 10 V/um.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

from piezo_rig.causes.cause import Context
from piezo_rig.causes.first_spring import GIVEN, HOLDING, REACHING, FirstSpring
from piezo_rig.chain.branches import Branches, FloatArray
from piezo_rig.chain.half_loops import HalfLoops


class RangeDependence(FirstSpring):
    """``slope`` and ``offset`` of k_1 over the input range."""

    id = "range-dependence"
    law: ClassVar[Mapping[str, float]] = {
        "range": 0.1, "range+drive": 0.1, "direction": 0.1, "time_since_turn+direction": 0.1,
        "first rise": 0.25,
    }  # fmt: skip

    meanings: ClassVar[Mapping[str, str]] = {
        **FirstSpring.meanings,
        "slope": "stiffness just after a turning point, by volt of the range before it",
        "ties": "1: a loop that is closed exactly goes on beyond; 0: it is forgotten",
    }
    like_speed = True
    optional: ClassVar[Mapping[str, str]] = {**REACHING, "ties": "1", **HOLDING}
    given: ClassVar[tuple[str, ...]] = (*GIVEN, "ties", *HOLDING)

    def shape(self, branches: Branches) -> Branches:
        keeps = self.parameters["ties"].value > 0 if "ties" in self.parameters else False
        return replace(super().shape(branches), keeps_ties=keeps)

    @classmethod
    def closings_in(cls, context: Context) -> tuple[float, ...]:
        """What is given back is like much else that a base lacks: where the noise is known."""
        return (0.0, 1.0) if context.repeated else cls.closings

    @staticmethod
    def history(loops: HalfLoops) -> FloatArray:
        return loops.range_v
