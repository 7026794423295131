"""Rungs that, taken together, predict far worse than the ladder began are taken back.

Every rung is judged as the climb holds data out. Where the figures hold out whole recordings of
other drives, a ladder may turn out to have followed one recording and to say nothing of the next:
what it names then stands for something else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from piezo_rig.diagnosis.found import NO_FINDINGS
from piezo_rig.diagnosis.held_out import Errors
from piezo_rig.diagnosis.ladder import Ladder

FAR = 2.0  # times the held-out error that a ladder begins with


def taken_back(ladder: Ladder, errors: Sequence[Errors]) -> tuple[Ladder, str] | None:
    """The ladder up to where it still predicts, and what is to be said; None where all of it does.

    Parameters
    ----------
    errors : held out, where the ladder begins and of every step
    """
    begun, *after = errors
    if not after or not _far(after[-1], begun):
        return None
    keep = max((k for k, e in enumerate(after, 1) if not _far(e, begun)), default=0)
    against = f"({after[-1].rms_nm:.3g} nm against {begun.rms_nm:.3g} nm)"
    gone = [s.cause for s in ladder.steps[keep:]]
    scans = list(ladder.scans)
    if scans:
        why = f"fits, but what it leads to predicts data that it has not seen far worse {against}"
        scans[-1] = replace(scans[-1], refused={
            **scans[-1].refused, **{cause: why for cause in gone if cause not in NO_FINDINGS},
        })  # fmt: skip
    said = (f"the model was extended by {', '.join(gone)} as well, which predicts data that it has "
            f"not seen far worse {against}: taken back")  # fmt: skip
    return replace(ladder, steps=ladder.steps[:keep], scans=tuple(scans)), said


def _far(errors: Errors, begun: Errors) -> bool:
    """Far worse on the whole, and not by the worst stretches alone."""
    return errors.rms_nm > FAR * begun.rms_nm and errors.mostly_nm > FAR * begun.mostly_nm
