"""The Maxwell resistive-capacitor actuator: the stage that every model has.

M. Goldfarb, N. Celanovic, IEEE Control Systems Magazine 17 (1997) 69-79;
thesis section 2.2. Elasto-slide elements in parallel carry the drive as a
force; the same element gives way after twice the displacement when the motion
reverses. Where another stage adds a law for the first spring, the table's own
first constant is 0 and the law gives it all.
"""

from __future__ import annotations

from functools import cached_property

from piezo_rig.chain.branches import Branches
from piezo_rig.chain.stage import Stage


class Maxwell(Stage):
    """Elements of the later branches, and of the first rise unless another stage has those."""

    id = "maxwell"
    place = "actuator"
    has_elements = True

    def branches(self) -> Branches:
        """The kernel's branches before any other stage shapes them."""
        return self._own

    @cached_property
    def _own(self) -> Branches:
        assert self.elements is not None
        return Branches.of(self.elements)
