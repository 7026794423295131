"""What goes with how warm its losses make an actuator: no cause of the catalogue, and like many.

Where speeds differ a stack that heats itself is longer, or shorter, after a fast stretch than
after a slow one, for seconds. A law of turning points, an asymmetry or a drift says much of that.
The dictionary has it by name; a cause that says less than its columns, and hardly anything beside
them, is not what happens.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from piezo_rig.diagnosis.dictionary import WARMTH
from piezo_rig.diagnosis.likelihood import Likelihood
from piezo_rig.diagnosis.linear import Linear
from piezo_rig.diagnosis.reduction import reduce
from piezo_rig.diagnosis.refit import Fitted, settle
from piezo_rig.diagnosis.scan import of_base
from piezo_rig.diagnosis.space import Space

PLAINLY = 10.0  # log-likelihood by which warmth must say more than a cause
OF_WARMTH = "what it does goes with how fast the drive was in the seconds before, as warmth does"
HARDLY = 0.3  # of what a cause says, that it says beside warmth at most


def of_warmth(space: Space, here: Fitted, fitted: Fitted, id: str) -> str | None:
    """Why a model's newest member is refused: what it says, warmth says better."""
    if of_base(id) or fitted.point.fixed:
        return None
    gained = fitted.evidence - here.evidence
    settle(space, here.point)
    warm = warmth(space, here.linear)
    if warm < gained + PLAINLY:
        return None
    settle(space, fitted.point)
    both = warmth(space, fitted.linear)
    return OF_WARMTH if gained + both - warm < HARDLY * gained else None


def warmth(space: Space, linear: Linear) -> float:
    """Log-likelihood that the columns of warmth say about a point."""
    mine = [k for k, tag in enumerate(space.tags) if tag == WARMTH]
    if not mine:
        return 0.0
    reduced = reduce(linear)
    rows = np.zeros((reduced.z.size, len(mine)))
    rows[: len(reduced.generic)] = reduced.generic[:, mine]
    alone = Likelihood(replace(reduced, trials=rows))
    return alone.evidence(range(len(mine))) - alone.evidence()
