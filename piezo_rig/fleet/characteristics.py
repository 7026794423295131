"""Numbers by which one actuator is compared with another, whatever its model's elements are."""

from __future__ import annotations

import numpy as np

from piezo_rig.chain import Model

POINTS = 201  # of one leg


def characteristics(model: Model) -> dict[str, float]:
    """What a model does over the range of drives that it was identified from.

    Returns
    -------
    ``drive_min_v`` and ``drive_max_v`` to the nearest volt; ``um_per_v``, travel over drive of the
    settled loop; ``loop_percent``, its largest opening over its travel; ``first_rise_um_per_v``,
    the same as ``um_per_v`` for the first rise. Empty where the model does not say its range.
    """
    low, high = model.provenance.get("drive_v", (0.0, 0.0))
    if not high > low:
        return {}
    up = np.linspace(low, high, POINTS)
    drive = np.concatenate([up, up[-2::-1], up[1:], up[-2::-1]])
    moved = model.place_um(drive)
    first = moved[:POINTS]
    rise = moved[2 * POINTS - 2 : 3 * POINTS - 2]
    fall = moved[3 * POINTS - 3 :][::-1]
    travel = float(rise[-1] - rise[0])
    return {
        "drive_min_v": float(round(low)), "drive_max_v": float(round(high)),
        "um_per_v": travel / (high - low),
        "loop_percent": 100.0 * float(np.max(fall - rise)) / travel if travel else float("nan"),
        "first_rise_um_per_v": float(first[-1] - first[0]) / (high - low),
    }
