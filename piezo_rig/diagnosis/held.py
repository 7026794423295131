"""What a model that is held fixed may be wrong by without anything being wrong.

A model that is refitted follows any memoryless bend with its powers and any density of thresholds
with its tables; both are projected off. A given model follows nothing, or nothing could be said
of a gain or a sensitivity. But whoever identified it without a bend fitted the bend as well as
springs and sliders can: what is left of a bend after that is what may be wrong, and no more.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.diagnosis import basis, dictionary
from piezo_rig.diagnosis.dictionary import Scales
from piezo_rig.diagnosis.groups import Group, Groups

FloatArray = NDArray[np.float64]
RIDGE = 1e-8  # of the scaled Gram matrix


def bends_left(
    groups: Groups, driven: Sequence[Group], model: Model, scales: Scales
) -> list[FloatArray]:
    """Powers of the drive less the best that the model's tables can make of them.

    Parameters
    ----------
    driven : the groups with the drive that reaches the actuator

    Returns
    -------
    per group, shape (powers, thinned samples)
    """
    bends = [groups.thinned(g, dictionary.powers(g, scales)) for g in driven]
    bands = [groups.thinned(g, basis.bands(model, g)) for g in groups.groups]
    gram = cross = np.zeros(0)
    for k, g in enumerate(groups.groups):
        for (a, b), cells in zip(groups.edges(g), groups.cells(g), strict=True):
            x, y = cells.centred(bands[k][:, a:b]), cells.centred(bends[k][:, a:b])
            more = g.repeats * x @ x.T, g.repeats * x @ y.T
            gram, cross = more if not gram.size else (gram + more[0], cross + more[1])
    size = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    ridged = gram * np.outer(size, size) + RIDGE * np.eye(size.size)
    shares = size[:, None] * np.linalg.solve(ridged, size[:, None] * cross)
    return [y - shares.T @ x for x, y in zip(bands, bends, strict=True)]
