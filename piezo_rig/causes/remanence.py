"""Remanence: a recording begins with memory left from the one before.

Physics: thermal agitation at rest frees the walls that a drive has left displaced, some of them
only after hours (ageing; D. Damjanovic, Rep. Prog. Phys. 61 (1998) 1267, section 6). The thesis
takes its actuator for virgin after a rest. Where the rest was too short, every element begins at
a fraction of where the recording before has left it, and that one at a fraction of what was left
before it: in play operators, p_r = fraction x p_r(end of the one before). Further back than a few
recordings nothing counts.

Shows as: first rises that are less steep after a large recording than after a small one, up to
the drive where the old memory is wiped out; all that follows is shifted by a constant, which no
offset shows. After equal recordings all first rises differ alike, as with an initiation stage.

Claimed only where the history is known: every recording says that it begins virgin, and when it
began. Beside an initiation stage the two add up: loops that begin with what is left, and what a
first rise has beyond them, on the first way to every drive in this recording.

Remedy: Let the actuator rest longer between recordings, or begin each with a decaying drive that
clears the memory.

Plausible: 0-0.3 after a rest that was thought to be long enough.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import ClassVar

import numpy as np

from piezo_rig.causes.cause import Cause, Context, FloatArray
from piezo_rig.chain.stage import Stage

RECORDINGS = 3  # looked back
PIECES = 400  # teeth of the saw that stands for what is left; more cost time
GRADED = 1.2
NEAR_IN_MEMORY = 0.01  # a kink wherever an element gives way: columns are those of one fraction
# more of it lasts up to a larger drive: a small share, enlarged, is no example of it
FRACTIONS = (0.02, 0.08, 0.2, 0.4, 0.7)


class Remanence(Cause):
    """``fraction`` of the memory that is left; 0 is a virgin beginning."""

    id = "remanence"
    place = "actuator"
    needs_known_order = True
    meanings: ClassVar[Mapping[str, str]] = {
        "fraction": "share of the memory of the recording before that is left",
    }
    units: ClassVar[Mapping[str, str]] = {"fraction": "1"}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"fraction": (0.0, 0.99)}
    near: ClassVar[float] = NEAR_IN_MEMORY
    scanned: ClassVar[tuple[str, float]] = ("fraction", 1.15)
    sharp: ClassVar[Mapping[str, float]] = {"fraction": 20.0}

    @cached_property
    def _prefaces(self) -> dict[int, tuple[Sequence[FloatArray], FloatArray]]:
        """What `preface` made of the drives that were asked for: each is, for every neighbour of a
        model.
        """
        return {}

    def preface(self, before: Sequence[FloatArray]) -> FloatArray:
        known = self._prefaces.get(id(before))
        if known is None or known[0] is not before:  # held, so that its id stays its own
            known = self._prefaces[id(before)] = before, self._made(before)
        return known[1]

    def _made(self, before: Sequence[FloatArray]) -> FloatArray:
        before = [b for b in before if b.size > 1][-RECORDINGS:]
        if not before or self["fraction"] <= 0.0:
            return np.empty(0)
        reach = max(float(np.max(np.abs(b - b[0]))) for b in before)
        r = reach * np.linspace(1.0, 0.0, PIECES + 1) ** GRADED
        state = np.zeros(r.size)
        for turns in before:
            for v in turns - turns[0]:
                state = np.clip(state, v - r, v + r)
            state = self["fraction"] * state
        return before[-1][0] + turns_to(r, state)

    @classmethod
    def variants(cls, context: Context) -> list[list[Stage]]:
        return [[cls.of(None, fraction=fraction)] for fraction in FRACTIONS]


def turns_to(r: FloatArray, state: FloatArray) -> FloatArray:
    """Turning points, from 0 V, that leave play operators of thresholds r in a given state.

    After a drive every state is a curve over r of slopes +1 and -1, a piece for every turning
    point that is remembered (Madelung). A curve of smaller slopes is drawn as a saw around it.

    Parameters
    ----------
    r, state : shape (n,), r descending to 0; the state is 0 at the first and nowhere steeper than 1
    """
    middle = state - 0.25 * np.append(-np.diff(r), 0.0)  # teeth stand on it: half above, half below
    middle[0] = 0.0
    return np.column_stack([middle - r, middle + r]).ravel()[1:]
