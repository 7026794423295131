"""Extremum dependence: the first spring follows the drive at the last turning point.

Physics: which domains can switch back depends on the field at which the
motion reversed. Thesis section 3.1(b), eq. 9-10: k_1 = slope x F_extre +
offset, with the displacement at which the first element gives way unchanged. The spring may keep
its force over a turning point (``carries`` 1), as springs and sliders do, or begin anew (0); with
a ``spring`` in whose place it stands it gives way after (k_before + k_now) dx / k_now, or at a
force that stays.

Shows as: half loops that begin at different drives differ right after the
turning point although their ranges agree.

Remedy: Nothing is broken: use the saved model, which knows it, in place of the classical one.

Plausible: thesis (Appendix B), 9.5e-4 V/um per V and -0.085 V/um; r-squared 0.03.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from piezo_rig.causes.first_spring import GIVEN, HOLDING, REACHING, FirstSpring
from piezo_rig.chain.branches import FloatArray
from piezo_rig.chain.half_loops import HalfLoops


class ExtremumDependence(FirstSpring):
    """``slope`` and ``offset`` of k_1 over the drive at the last turning point."""

    id = "extremum-dependence"
    law: ClassVar[Mapping[str, float]] = {
        "drive+direction": 0.1, "range+drive": 0.1, "time_since_turn+direction": 0.1,
        "first rise": 0.25,
    }  # fmt: skip

    meanings: ClassVar[Mapping[str, str]] = {
        **FirstSpring.meanings,
        "slope": "stiffness just after a turning point, by volt of the drive at it",
    }
    optional: ClassVar[Mapping[str, str]] = {**REACHING, **HOLDING}
    given: ClassVar[tuple[str, ...]] = (*GIVEN, *HOLDING)
    closings: ClassVar[tuple[float, ...]] = (0.0, 1.0)

    @staticmethod
    def history(loops: HalfLoops) -> FloatArray:
        return loops.extremum_v
