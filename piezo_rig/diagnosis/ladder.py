"""What a climb leaves: the rungs that were accepted, in order, and every look on the way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from piezo_rig.diagnosis.refit import Fitted
from piezo_rig.diagnosis.scan import Scan


@dataclass(frozen=True, eq=False)
class Step:
    """One accepted cause, and the model with it.

    ``rivals`` were refitted to nearly the same, with what a linear look had promised of each.
    ``doubted`` says that another law of the first spring came near it.
    """

    cause: str
    p_value: float
    fitted: Fitted
    rivals: Mapping[str, float] = field(default_factory=dict)
    doubted: bool = False


@dataclass(frozen=True, eq=False)
class Ladder:
    """Everything that was accepted, in order, and the last look at what is left."""

    first: Fitted
    steps: tuple[Step, ...]
    scans: tuple[Scan, ...]
    ended: str = ""  # why it was climbed no further, where something went wrong

    @property
    def last(self) -> Fitted:
        return self.steps[-1].fitted if self.steps else self.first
