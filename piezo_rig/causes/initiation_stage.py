"""Initiation stage: the first rise of a virgin actuator has its own element set.

Physics: a poled ceramic that has rested holds domains that switch on the first
rise only; afterwards a smaller number follows the field. The first rise is
therefore steeper or flatter than the matching parts of all later half loops
(thesis section 2.3, figure 2-2, eq. 12-13).

Shows as: a misfit on the first rise and on every excursion beyond the largest
past drive, none elsewhere. Needs a first rise from rest in the data.

Plausible: slopes that differ by 5 to 50 % from those of later cycles.
"""

from __future__ import annotations

from dataclasses import replace

from piezo_rig.chain.branches import Branches, Curve
from piezo_rig.chain.stage import Stage


class InitiationStage(Stage):
    """An element table for the initiation curve; no parameters."""

    id = "initiation-stage"
    place = "actuator"
    has_elements = True

    def shape(self, branches: Branches) -> Branches:
        assert self.elements is not None
        return replace(branches, initiation=Curve.of(self.elements))
