"""What even an oracle cannot tell from what is hidden: as large a set may be reported."""

from __future__ import annotations

import numpy as np

from piezo_rig.scoring.oracle import Oracle
from piezo_rig.studies.hidden.case import Case
from piezo_rig.studies.hidden.effects import EFFECTS, Effect
from piezo_rig.studies.hidden.history import CycleAging
from piezo_rig.studies.hidden.sizing import apart, changes_of

KNOWN: dict[str, type[Effect]] = {**EFFECTS, CycleAging.cause: CycleAging}
TOLD = 4.0  # d' that is left of a cause off another; less is not told apart (design 6.4)
DRAWS = 4  # of the constants of a form


def left_off(case: Case) -> dict[str, dict[str, float]]:
    """d' that is left of every hidden effect off each cause of the catalogue that is not hidden.

    Off everything else that is hidden and off one example of the other cause: the nearest of its
    forms with constants drawn `DRAWS` times. What lies between examples, and sizes at which an
    effect is not proportional to its size any more, are not searched: less may be left.
    """
    oracle = Oracle.of([c.drive_v for c in case.conditions], case.noise, case.repeats)
    change = changes_of(case.body, case.conditions, case.repeats, case.seed)
    hidden = [change(e) for e in case.effects]
    drives = [c.drive_v for c in case.conditions] * case.repeats
    rng = np.random.default_rng([case.seed, 11])
    out: dict[str, dict[str, float]] = {e.cause: {} for e in case.effects}
    for other, kind in KNOWN.items():
        if other in out:
            continue
        left = [
            apart(oracle, [*hidden, change(example)], case.repeats)
            for form in kind.forms for _ in range(DRAWS)
            for example in [kind.drawn(rng, form).placed(case.body, drives).sized(kind.start)]
        ]  # fmt: skip
        for k, cause in enumerate(out):
            out[cause][other] = min(d[k] for d in left)
    return out


def not_told(case: Case) -> dict[str, list[str]]:
    """Every hidden effect, and the causes that the oracle takes for it as well."""
    return {
        cause: [other for other, d in others.items() if d < TOLD]
        for cause, others in left_off(case).items()
    }
