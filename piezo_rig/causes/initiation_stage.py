"""Initiation stage: the first rise of a virgin actuator has its own element set.

Physics: a poled ceramic that has rested holds domains that switch on the first
rise only; afterwards a smaller number follows the field. The first rise is
therefore steeper or flatter than the matching parts of all later half loops
(thesis section 2.3, figure 2-2, eq. 12-13).

Shows as: a misfit on the first rise and on every excursion beyond the largest
past drive, none elsewhere. Needs a first rise from rest in the data.

Remedy: Play one full cycle before a measurement, or use the saved model, which has a first rise of
its own.

Plausible: slopes that differ by 5 to 50 % from those of later cycles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezo_rig.causes.cause import Cause, Context, FloatArray
from piezo_rig.chain.branches import Branches, Curve
from piezo_rig.chain.elements import Elements
from piezo_rig.chain.stage import Stage

SIZE = 0.01


class InitiationStage(Cause):
    """An element table for the initiation curve; no parameters."""

    id = "initiation-stage"
    place = "actuator"
    has_elements = True
    needs_first_rise = True

    def shape(self, branches: Branches) -> Branches:
        assert self.elements is not None
        return replace(branches, initiation=Curve.of(self.elements))

    @classmethod
    def trials(cls, context: Context) -> list[Stage]:
        curve = context.model.branches().initiation
        knots = np.append(curve.knots_v, 1.05 * context.span_v)
        knots = np.append(knots[:-1], max(knots[-1], 1.05 * knots[-2]) if knots.size > 1 else knots)
        u = (knots - 0.5 * np.diff(knots, prepend=0.0)) / knots[-1]
        c = curve.compliance_um_per_v
        return [
            cls.of(Elements.from_curve(knots, c * (1.0 + SIZE * u**power))) for power in range(4)
        ]

    @classmethod
    def begun(cls, trials: Sequence[Stage], shares: FloatArray) -> Stage:
        tables = [t.elements for t in trials]
        knots = tables[0].knots_v if tables[0] else np.empty(0)
        u = (knots - 0.5 * np.diff(knots, prepend=0.0)) / knots[-1]
        first = tables[0]
        assert first is not None
        c = 1.0 / first.slopes / (1.0 + SIZE)
        wanted = 1.0 + SIZE * sum(s * u**power for power, s in enumerate(shares))
        return cls.of(Elements.from_curve(knots, c * np.clip(wanted, 0.05, 20.0)))
