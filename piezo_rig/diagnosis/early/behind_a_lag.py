"""A recorded drive at any instant, behind a first-order lag: straight between its points, or held.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezo_rig.diagnosis.early.corners import At

FloatArray = NDArray[np.float64]


def lines(v: FloatArray, tau: float, places: FloatArray | None = None) -> At:
    """Straight between points, behind a lag of ``tau`` samples (0: none), at any instant.

    ``places`` : of the points, in samples; the samples themselves by default
    """
    from piezo_rig.chain.relaxation import off

    where = np.arange(float(v.size)) if places is None else places
    wide = np.append(np.diff(where), 1.0)
    slopes = np.append(np.diff(v), 0.0) / wide
    behind = np.zeros(v.size)  # how far the lag is behind at each point
    if tau > 0.0:
        behind = -off(np.ascontiguousarray(where), np.ascontiguousarray(v), tau)

    def at(position: FloatArray) -> FloatArray:
        if places is None:
            j = np.floor(position).astype(int)
        else:
            j = np.searchsorted(places, position, side="right") - 1
        j = np.clip(j, 0, v.size - 1)
        since = np.clip(position - where[j], 0.0, wide[j])
        here = v[j] + since * slopes[j]
        if tau > 0.0:
            here = here - tau * slopes[j] - (behind[j] - tau * slopes[j]) * np.exp(-since / tau)
        return here

    return at


def stairs(v: FloatArray, tau: float) -> At:
    """Held from each sample to the next, behind a lag of ``tau`` samples, at any instant."""
    from piezo_rig.chain.relaxation import held

    state = held(np.ascontiguousarray(v), tau)

    def at(position: FloatArray) -> FloatArray:
        j = np.clip(np.ceil(position).astype(int) - 1, 0, v.size - 1)
        since = np.clip(position - j, 0.0, 1.0)
        return v[j] + (state[j] - v[j]) * np.exp(-since / tau)

    return at
