"""Rungs are taken back that predict far worse than the ladder began, or are in doubt altogether.

Every rung is judged as the climb holds data out. Where the figures hold out whole recordings of
other drives, a ladder may turn out to have followed one recording and to say nothing of the next:
what it names then stands for something else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.diagnosis.found import NO_FINDINGS, Finding
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
    gone = ", ".join(s.cause for s in ladder.steps[keep:])
    said = (f"the model was extended by {gone} as well, which predicts data that it has not seen "
            f"far worse {against}: taken back")  # fmt: skip
    why = f"fits, but what it leads to predicts data that it has not seen far worse {against}"
    return _up_to(ladder, keep, why), said


def without_the_doubtful(ladder: Ladder, findings: Sequence[Finding]) -> Ladder | None:
    """The ladder without its last rung, where nothing about that is sure; None where something is.

    Neither how much there is of it, for every number that is known to an interval may as well be
    that of nothing, nor whether it helps to predict.
    """
    last = findings[-1] if findings else None
    if last is None or not ladder.steps or ladder.steps[-1].cause != last.cause:
        return None
    kind = CAUSES[last.cause]
    nothing = kind.neutral if issubclass(kind, Cause) else {}
    shape = kind.optional if issubclass(kind, Cause) else {}  # says nothing of how much there is
    known = {
        n: p.ci95 for n, p in last.parameters.items() if p.ci95 is not None and n not in shape
    }
    sure = [n for n, (a, b) in known.items() if not a <= nothing.get(n, 0.0) <= b]
    if not known or sure or last.gain_ci95 is None or last.gain_ci95[0] > 0.0:
        return None
    why = "fits, but neither how much there is of it nor whether it helps to predict is sure"
    return _up_to(ladder, len(ladder.steps) - 1, why)


def _up_to(ladder: Ladder, keep: int, why: str) -> Ladder:
    """So many steps of a ladder, and why the causes behind them were left out."""
    gone = {s.cause: why for s in ladder.steps[keep:] if s.cause not in NO_FINDINGS}
    scans = list(ladder.scans)
    if scans:
        scans[-1] = replace(scans[-1], refused={**scans[-1].refused, **gone})
    return replace(ladder, steps=ladder.steps[:keep], scans=tuple(scans))


def _far(errors: Errors, begun: Errors) -> bool:
    """Far worse on the whole, and not by the worst stretches alone."""
    return errors.rms_nm > FAR * begun.rms_nm and errors.mostly_nm > FAR * begun.mostly_nm
