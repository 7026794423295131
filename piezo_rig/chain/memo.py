"""What was made of a drive, kept for models that differ little from each other."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain.stage import Signal

if TYPE_CHECKING:
    from piezo_rig.chain.model import Model

FloatArray = NDArray[np.float64]
KEPT = 4


class Memo:
    """What one model made of one drive, stage by stage, for models that differ little from it.

    Whoever simulates the same drive with many neighbours of a model keeps one of these for it.
    A stage that is the same object after the same stages is not played again.
    """

    def __init__(self) -> None:
        self._of: object = None
        self._known: dict[tuple[object, ...], Any] = {}
        self._whole: dict[int, tuple[Model, FloatArray]] = {}
        self._begun: tuple[Signal, int] | None = None

    def begun(self, make: Callable[[], tuple[Signal, int]]) -> tuple[Signal, int]:
        """The signal before any stage, and how many samples of it come before the drive."""
        if self._begun is None:
            self._begun = make()
        return self._begun

    def whole(self, model: Model, make: Callable[[], FloatArray]) -> FloatArray:
        """All that the latest few models made of the drive, not to be written to."""
        if id(model) not in self._whole:
            while len(self._whole) >= KEPT:
                self._whole.pop(next(iter(self._whole)))
            made = make().view()  # what it is made from stays as it is: stages compile by flags
            made.flags.writeable = False
            self._whole[id(model)] = (model, made)  # held, so that its id stays its own
        return self._whole[id(model)][1]

    def remember(self, model: Model) -> None:
        """From now on what this model does is kept, and nothing of what was kept before."""
        if self._of is not model:
            self._of = model  # held, so that no other stage takes the place of one of its stages
            self._known = {}

    def get(self, model: Model, key: tuple[object, ...], make: Callable[[], Any]) -> Any:
        """What is known by a key, else what ``make`` makes."""
        if key in self._known:
            return self._known[key]
        made = make()
        if model is self._of:
            self._known[key] = made
        return made
