"""What a stage in C is made of, and where it stands."""

from __future__ import annotations

from dataclasses import dataclass

from piezo_rig.chain.branches import Branches


@dataclass(frozen=True)
class Part:
    """One stage in C: constant tables, members of the state, statements of the step."""

    tables: str = ""
    members: str = ""
    step: str = ""


@dataclass(frozen=True)
class Place:
    """Where a part stands: the C prefix, a number of its own, the sample period, the branches."""

    name: str
    index: int
    period_s: float
    branches: Branches

    def own(self, word: str) -> str:
        """A member of the state that no other part has."""
        return f"p{self.index}_{word}"
