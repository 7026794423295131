"""Gain or sensitivity where a fixed model is wrong by more than tells the two apart.

The two move the displacement nearly alike. By how much they differ is compared with the noise in
`confusion`; but where, with everything that was found, the model stays further off than it was at
home, it is wrong by something that nobody has described, and that may look like the difference.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.chain import Model
from piezo_rig.diagnosis.refit import Fitted
from piezo_rig.diagnosis.scan import candidates
from piezo_rig.diagnosis.space import Space

FloatArray = NDArray[np.float64]


def within_what_is_wrong(
    space: Space, fitted: Fitted, cause: str, left_um: float, noise_um: float
) -> list[str]:
    """Causes of a fixed model whose effects differ by less than it is wrong by here, nearest first.

    ``left_um`` : rms that is left with everything that was found; ``noise_um`` : of it
    """
    kind = CAUSES[cause]
    expected_um = max(space.own_um, noise_um)
    wrong_um = float(np.sqrt(max(left_um**2 - expected_um**2, 0.0)))
    if not (issubclass(kind, Cause) and kind.needs_fixed_model and wrong_um > 0.0):
        return []
    model = fitted.point.model
    less = model.without(cause)
    base = _predicted(space, less)
    effect = _predicted(space, model) - base
    apart = {}
    for other in candidates(space, less)[0]:
        if other.id != cause and CAUSES[other.id].needs_fixed_model:  # type: ignore[attr-defined]
            moved = [_predicted(space, m) - base for _, m in other.pairs(less)]
            apart[other.id] = min(_beside_um(effect, x) for x in moved)
    return sorted((c for c in apart if apart[c] < wrong_um), key=lambda c: apart[c])


def _predicted(space: Space, model: Model) -> FloatArray:
    """Displacement of all groups one after another, each stretch from its own mean, um."""
    rows = []
    for g in space.groups.groups:
        x = g.predicted(model)
        rows += [x[a:b] - x[a:b].mean() for a, b in g.blocks]
    return np.concatenate(rows)


def _beside_um(effect: FloatArray, other: FloatArray) -> float:
    """Rms (um) that is left of an effect by the best share of another."""
    left = effect - (effect @ other) / max(float(other @ other), 1e-300) * other
    return float(np.sqrt(np.mean(left**2)))
