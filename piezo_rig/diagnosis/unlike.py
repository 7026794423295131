"""Causes where a model is wrong by more than tells them apart.

A gain and a sensitivity move the displacement nearly alike. By how much they differ is compared
with the noise in `confusion`; but where, with everything that was found, the model stays further
off than it was at home, it is wrong by something that nobody has described, and that may look like
the difference.

So it is with a delay, a lag and a loop that opens with speed where something remains unexplained.
Of data with much structure that nobody has described any of them follows a little more than the
others: a likelihood, which takes that for noise, tells them apart, and should not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.chain import Model
from piezo_rig.diagnosis.confusion import own_columns
from piezo_rig.diagnosis.refit import Fitted
from piezo_rig.diagnosis.scan import by_speed, candidates
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


def within_what_remains(space: Space, fitted: Fitted, cause: str, rest_um: float) -> list[str]:
    """Causes that go by speed, as this one does, and differ from it by less than what remains
    unexplained, once all that is fitted follows; nearest first.

    ``rest_um`` : rms of that
    """
    if not by_speed(cause):
        return []
    point, model = fitted.point, fitted.point.model
    less, data = model.without(cause), space.together
    effect = data.changes(data.remembered(less), [model])
    own = set(own_columns(point, cause))
    free = [j for j in range(point.values().size) if j not in own]
    rows = _centred(space, np.concatenate([effect, point.tangent(data, free)]))
    base, _ = np.linalg.qr(rows[1:].T)
    effect = rows[0] - base @ (base.T @ rows[0])
    apart = {}
    for other in candidates(space, less)[0]:
        if other.id == cause or not by_speed(other.id) or model.stage(other.id) is not None:
            continue
        moved = _centred(
            space, data.changes(data.remembered(less), [m for _, m in other.pairs(less)])
        )
        moved -= (moved @ base) @ base.T
        apart[other.id] = min(_beside_um(effect, x) for x in moved)
    return sorted((c for c in apart if apart[c] < rest_um), key=lambda c: apart[c])


def _centred(space: Space, rows: FloatArray) -> FloatArray:
    """Rows of all thinned data, (k, n), each stretch less its mean, every sample as heavy."""
    parts = []
    for index, g in enumerate(space.groups.groups):
        mine = rows[:, space.together.part(index)]
        for (a, b), cells in zip(space.groups.edges(g), space.groups.cells(g), strict=True):
            parts.append(cells.centred(mine[:, a:b]))
    return np.concatenate(parts, axis=1)


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
