"""Models with every stage that a compensation inverts, and drives to play them with."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Elements, Maxwell, Model
from piezo_rig.chain.bend import Bend

DX = 0.3
LATER = [0.9, 0.6, 0.5, 0.4, 0.3, 0.2, 5.0]  # V/um; 8 V/um at a turning point
FIRST = [0.7, 0.2, 0.5, 0.3, 0.4, 0.1, 5.5]


def table(springs):
    return Elements(np.array(springs), DX * np.arange(1.0, len(springs) + 1))


EXTRAS = {
    "drive-gain": {"ratio": 1.03, "stays_v": 75.0},
    "drive-clipping": {"lower": -1000.0, "upper": 58.0},
    "slew-limit": {"limit": 4000.0},
    "amplifier-lag": {"tau": 1.5e-4},
    "range-dependence": {"slope": 0.01, "offset": 0.1},
    "extremum-dependence": {"slope": -0.004, "offset": 0.2, "reach": 0.25, "closing": 1.0,
                            "taper": 1.0},
    "direction-asymmetry": {"ratio": 1.1, "reach": 0.4, "closing": 0.5, "taper": 0.0},
    "creep": {"rate_per_decade": 0.02},
    "rate-dependence": {"lag_um": 0.02, "exponent": 1.0, "window_s": 2e-3},
    "resonance": {"share": 0.1, "frequency": 620.0, "damping": 0.03},
    "cycle-aging": {"rate_per_decade": 0.01},
}  # fmt: skip
BODY = {
    "input-bend": {"square": -3.0, "cube": 1.0, "from_v": 0.0, "over_v": 75.0},
    "output-bend": {"square": -0.004, "cube": 2e-4},
}  # fmt: skip
BENT = {"from_v": 0.0, "over_v": 75.0, "square": 0.1, "cube": -0.2, "fourth": 0.1, "fifth": 0.05}


def model_with(*ids, **changed):
    """The springs with these causes (and ``bend``, ``initiation-stage``), in the chain's order."""
    model = Model((Maxwell.of(table(LATER)),))
    for id in ids:
        if id == "bend":
            stage = Bend.of(None, **BENT)
        elif id == "initiation-stage":
            stage = CAUSES[id].of(table(FIRST))
        else:
            stage = CAUSES[id].of(None, **{**(EXTRAS | BODY)[id], **changed.get(id, {})})
        model = model.with_stage(stage)
    return model


EVERY = ("bend", "initiation-stage", *EXTRAS)


def legs(turns, points):
    """Straight lines through turning points, `points` samples each, and their times at 5 kHz."""
    parts = [np.linspace(a, b, points, endpoint=False) for a, b in pairwise(turns)]
    drive = np.append(np.concatenate(parts), turns[-1])
    return np.arange(drive.size) / 5000.0, drive
