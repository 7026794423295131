"""Direction asymmetry: ascending and descending half loops differ in shape.

Physics: switching with the poling direction and against it are not mirror
images. Thesis section 2.3, figure 2-3: ascending half loops begin steeper
than descending ones; chapter 5 leaves the model of it to future work. Here
the first slope is multiplied by 2r/(1+r) on ascending half loops and by
2/(1+r) on descending ones, so that their mean stays.

Shows as: a difference between half loops right after the turning point that
follows the direction and nothing else.

Plausible: ratios of 0.9 to 1.1.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import GIVEN, REACHING, SCANNED, Cause, Context, forms, reaching
from piezo_rig.chain.branches import Branches, FloatArray
from piezo_rig.chain.half_loops import HalfLoops
from piezo_rig.chain.stage import Stage
from piezo_rig.errors import InputError


class DirectionAsymmetry(Cause):
    """``ratio`` of the first slopes, ascending over descending."""

    id = "direction-asymmetry"
    place = "actuator"
    law: ClassVar[tuple[tuple[str, ...], float]] = (("direction", "drive+direction"), 0.1)
    units: ClassVar[Mapping[str, str]] = {"ratio": "1"}
    neutral: ClassVar[Mapping[str, float]] = {"ratio": 1.0}
    optional: ClassVar[Mapping[str, str]] = REACHING
    given: ClassVar[tuple[str, ...]] = GIVEN
    scanned: ClassVar[tuple[str, float]] = SCANNED
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {
        "ratio": (0.2, 5.0),
        "reach": (1e-6, np.inf),
    }

    def shape(self, branches: Branches) -> Branches:
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
            [cls.of(None, ratio=1.01, **form)] for form in forms(context, (0.0, 1.0))
        ]
