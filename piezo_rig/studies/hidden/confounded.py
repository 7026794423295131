"""What even an oracle cannot tell from what is hidden: as large a set may be reported."""

from __future__ import annotations

import numpy as np

from piezo_rig.scoring.oracle import Oracle
from piezo_rig.studies.hidden.case import Case
from piezo_rig.studies.hidden.effects import EFFECTS
from piezo_rig.studies.hidden.sizing import apart, changes_of

TOLD = 4.0  # d' that is left of a cause off another; less is not told apart (design 6.4)
DRAWS = 4  # of the constants of a form


def not_told(case: Case) -> dict[str, list[str]]:
    """Every hidden cause of the catalogue, and the others that the oracle takes for it as well.

    Off everything else that is hidden and off one example of the other cause, in each of its forms
    with constants drawn `DRAWS` times, less than `TOLD` is left of it. What lies between examples,
    and sizes at which an effect is not proportional to its size any more, are not searched: the
    sets may be larger.
    """
    oracle = Oracle.of([c.drive_v for c in case.conditions], case.noise, case.repeats)
    change = changes_of(case.body, case.conditions, case.repeats, case.seed)
    hidden = [(e.cause, change(e)) for e in case.effects]
    drives = [c.drive_v for c in case.conditions] * case.repeats
    rng = np.random.default_rng([case.seed, 11])
    out: dict[str, list[str]] = {e.cause: [] for e in case.effects}
    for other, kind in EFFECTS.items():
        if other in out:
            continue
        examples = [
            change(kind.drawn(rng, form).placed(case.body, drives).sized(kind.start))
            for form in kind.forms for _ in range(DRAWS)
        ]  # fmt: skip
        for k, (cause, _) in enumerate(hidden):
            left = min(
                apart(oracle, [*(c for _, c in hidden), e], case.repeats)[k] for e in examples
            )
            if left < TOLD:
                out[cause].append(other)
    return out
