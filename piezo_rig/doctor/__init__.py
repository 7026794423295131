"""Checks a rig before the day begins, one line of a checklist after the other.

First every instrument by itself: does it answer, is it the expected one, is its error queue
empty. Then the bench as a whole: brought to rest, its settings read back, the sensor's noise at
rest, two voltages held and the upper rail touched, and back to rest, whatever happens.
"""

from __future__ import annotations

from collections.abc import Iterator

from piezo_rig.config import Rig
from piezo_rig.doctor.check import Check
from piezo_rig.doctor.instruments import one_by_one
from piezo_rig.doctor.whole_bench import Confirm, together


def examine(rig: Rig, confirm: Confirm) -> Iterator[Check]:
    """All checks of a rig, in order; the stack is at rest when it ends or is closed.

    Parameters
    ----------
    rig : the config; a simulated one gets its instruments started
    confirm : asks the operator a yes-or-no question (the interferometer's switch)
    """
    alone = list(one_by_one(rig))
    yield from alone
    if any(check.status == "FAULT" for check in alone):
        yield Check("skip", "bench", "nothing was moved, because an instrument is not in order")
        return
    yield from together(rig, confirm)


__all__ = ["Check", "Confirm", "examine"]
