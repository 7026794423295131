"""Whether a member of a model says anything, by its own numbers."""

from __future__ import annotations

import numpy as np
from scipy import stats

from piezo_rig.causes import CAUSES
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.refit import Fitted

DIFFERENT = 1e-4  # a member must differ from nothing at this level


def worth_needed(fitted: Fitted, id: str) -> float:
    """Log-likelihood that a table of its own must be worth: half of what chance gives it."""
    stage = fitted.point.model.stage(id)
    assert stage is not None
    assert stage.elements is not None
    return 0.25 * len(stage.elements)


def needless(fitted: Fitted, causes: list[str]) -> str | None:
    """A member whose parameters are not different from doing nothing."""
    values = fitted.point.values()[fitted.point.linear :]
    for cause in causes:
        kind = CAUSES[cause]
        index = [
            j
            for j, (id, name) in enumerate(fitted.point.names)
            if id == cause
            and name not in getattr(kind, "priors", {})
            and name not in getattr(kind, "optional", {})
        ]
        if not index:
            continue
        off = values[index] - [kind.neutral.get(fitted.point.names[j][1], 0.0) for j in index]
        covariance = fitted.covariance[np.ix_(index, index)]
        distance = float(off @ np.linalg.solve(covariance, off))
        if distance < stats.chi2.isf(DIFFERENT, len(index)):
            return cause
    return None


def does_nothing(point: Point, id: str) -> bool:
    stage = point.model.stage(id)
    assert stage is not None
    names = [n for i, n in point.names if i == id]
    kind = type(stage)
    scale = {n: s for i, n, s in point.sizes if i == id}
    if not names:
        return False
    for name in names:  # a law that runs into its limit is not this law
        low, high = getattr(kind, "limits", {}).get(name, (-np.inf, np.inf))
        if not low < stage[name] < high:
            return True
    main = names[0]
    return abs(stage[main] - kind.neutral.get(main, 0.0)) < 1e-3 * scale[main]
