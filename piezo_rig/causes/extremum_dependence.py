"""Extremum dependence: the first spring follows the drive at the last turning point.

Physics: which domains can switch back depends on the field at which the
motion reversed. Thesis section 3.1(b), eq. 9-10: k_1 = slope x F_extre +
offset, with the displacement at which the first element gives way unchanged.

Shows as: half loops that begin at different drives differ right after the
turning point although their ranges agree.

Plausible: thesis (Appendix B), 9.5e-4 V/um per V and -0.085 V/um; r-squared 0.03.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

from piezo_rig.causes.cause import Cause, Context, joined_first_bands
from piezo_rig.chain.branches import Branches, FloatArray
from piezo_rig.chain.half_loops import HalfLoops
from piezo_rig.chain.model import Model
from piezo_rig.chain.stage import Stage


class ExtremumDependence(Cause):
    """``slope`` and ``offset`` of k_1 over the drive at the last turning point."""

    id = "extremum-dependence"
    place = "actuator"
    law: ClassVar[tuple[tuple[str, ...], float]] = (
        ("drive+direction", "range+drive", "time_since_turn+direction"), 0.1,
    )
    units: ClassVar[Mapping[str, str]] = {"slope": "V/um/V", "offset": "V/um"}

    def shape(self, branches: Branches) -> Branches:
        def law(slopes: FloatArray, loops: HalfLoops) -> FloatArray:
            return slopes + self["slope"] * loops.extremum_v + self["offset"]

        return replace(branches, laws=(*branches.laws, law))

    @classmethod
    def trials(cls, context: Context) -> list[Stage]:
        size = 0.01 * context.model.branches().first_slope_v_per_um
        return [cls.of(None, slope=size / context.span_v, offset=0.0)]

    @classmethod
    def bases(cls, model: Model) -> list[Model]:
        return joined_first_bands(model)
