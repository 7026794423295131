"""What a model says is left in an actuator of the drives before, for columns that begin with it.

A virgin group whose recordings are remembered to have been played after others begins where those
have left it: bands of the element tables and fine thresholds too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.diagnosis.groups import Group

FloatArray = NDArray[np.float64]


def left_before(model: Model) -> tuple[float, ...]:
    """Numbers on which all that depends; none where nothing is left."""
    return tuple(p.value for s in model.remembering for p in s.parameters.values())


def played_before(model: Model, group: Group) -> list[tuple[float, FloatArray]]:
    """Drives that leave a virgin actuator as the group found it, and the share of each."""
    if not (group.virgin and group.earlier and model.remembering):
        return [(1.0, np.empty(0))]
    return [(share, _volts(model, group, before)) for share, before in group.earlier]


def _volts(model: Model, group: Group, before: Sequence[FloatArray]) -> FloatArray:
    volts = np.empty(0)
    for stage in model.remembering:
        volts = np.concatenate([group.drive_v[:1], stage.preface(before), volts])
    return volts
