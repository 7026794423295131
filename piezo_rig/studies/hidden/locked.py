"""The displacement of a body under everything that is locked to the drive."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from piezo_rig.studies.hidden.body import Body
from piezo_rig.studies.hidden.effects import Effect

FloatArray = NDArray[np.float64]


def locked(
    body: Body, effects: Sequence[Effect], time: FloatArray, drive: FloatArray
) -> FloatArray:
    """Displacement (n,) with everything that is locked to the drive; not zeroed."""
    v = drive
    for e in effects:
        v = e.on_drive(time, v)
    base = body.displacement(v)
    x = base
    for e in effects:
        other = e.on_body(body, time, v, base)
        if other is not None:
            x = x + (other - base)
    for e in effects:
        x = e.on_actuator(time, v, x)
    for e in effects:
        x = e.on_sensor(time, v, x)
    for e in effects:
        x = e.on_record(time, x)
    return x
