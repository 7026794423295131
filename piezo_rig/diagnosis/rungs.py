"""Errors of every rung, what each gained, and what their laws may have left."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.diagnosis.found import EVENTS, NO_FINDINGS, Rung
from piezo_rig.diagnosis.held_out import Errors, gain

Gain = tuple[float | None, list[float] | None]  # percent, and its interval; None where none is

def rungs_of(
    names: Sequence[str], errors: Sequence[Errors], rng: np.random.Generator
) -> tuple[list[Rung], list[Gain]]:
    """Errors of every rung, and the gain of each against the one before."""
    rungs, count = [], 0
    for i, (added, e) in enumerate(zip(names, errors, strict=True)):
        mine = i > 0 and added not in NO_FINDINGS
        rungs.append(Rung(added, e.rms_nm, e.max_percent, count if mine else None))
        count += mine
    return rungs, [gain(before, after, rng) for before, after in pairwise(errors)]


def by_laws_nm(rungs: Sequence[Rung], only: str | None = None) -> float:
    """Rms error that causes with a law, or one of them, may have left of what they took; tables
    and bends fit whatever there is.
    """
    def leaves(cause: str) -> float:
        kind = CAUSES[cause]
        return kind.leaves if issubclass(kind, Cause) else 0.0

    square = sum(
        leaves(after.added) ** 2 * max(before.rms_nm**2 - after.rms_nm**2, 0.0)
        for before, after in pairwise(rungs)
        if after.added not in NO_FINDINGS and not CAUSES[after.added].has_elements
        and after.added not in EVENTS and only in (None, after.added)
    )  # fmt: skip
    return float(np.sqrt(square))
