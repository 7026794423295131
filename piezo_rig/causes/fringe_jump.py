"""Fringe jump: the interferometer's counter loses or gains steps of lambda/8.

Physics: the counter counts quadrants of the interference signal; dirt in the beam, a knock or a
velocity beyond its bandwidth costs it some. HeNe at 632.8 nm: 79.1 nm a step.

Shows as: a step of a whole multiple of 79.1 nm from one sample to the next, which stays. Nothing
else of this bench moves by whole multiples: hum and lost samples make steps of any size.

Remedy: Check alignment, beam and reflectivity at the times that are listed; the interferometer lost
count. Positions after a jump are off by it.

Plausible: one in a recording, after a knock several; 1 to some tens of steps.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from piezo_rig.causes.cause import Cause

STEP_NM = 79.1


class FringeJump(Cause):
    """``step`` in nm, and the ``time`` in the sweep at which it comes."""

    id = "fringe-jump"
    place = "sensor"
    locked_to = "clock"
    meanings: ClassVar[Mapping[str, str]] = {
        "step": "size of the jump, a whole number of eighths of a wavelength",
        "time": "from the beginning of its recording",
        "sweep": "recording that it is in",
    }
    units: ClassVar[Mapping[str, str]] = {"step": "nm", "time": "s"}
    optional: ClassVar[Mapping[str, str]] = {"sweep": "1"}
