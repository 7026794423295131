"""Small models and drives that the tests of the chain share."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from piezo_rig.causes import CAUSES, named_model
from piezo_rig.chain import Elements, Maxwell, Model

DX = 0.3
K = [0.9, 0.6, -0.2, 0.4, 0.3, -0.1, 5.0]  # one negative spring is normal, two are fine
FIRST = [0.7, 0.2, 0.5, -0.1, 0.4, 0.1, 5.5]


def table(springs):
    return Elements(np.array(springs), DX * np.arange(1.0, len(springs) + 1))


def ride(turns, points):
    """A drive over turning points with `points` samples on every stretch."""
    parts = [a + (b - a) * np.arange(1, points + 1) / points for a, b in pairwise(turns)]
    drive = np.concatenate([[turns[0]], *parts])
    drive[::points] = turns
    return drive


def play(model, drive):
    return model.simulate(np.arange(drive.size) / 1e4, drive)


LAWS = {
    "range": (
        lambda span, extremum, sign: 0.03 * span - 0.2,
        {"range-dependence": {"slope": 0.03, "offset": -0.2}},
    ),
    "extremum": (
        lambda span, extremum, sign: 0.02 * extremum + 0.1,
        {"extremum-dependence": {"slope": 0.02, "offset": 0.1}},
    ),
    "range-extremum": (
        lambda span, extremum, sign: 0.03 * span - 0.2 - 0.01 * extremum,
        {
            "range-dependence": {"slope": 0.03, "offset": -0.2},
            "extremum-dependence": {"slope": -0.01, "offset": 0.0},
        },
    ),
    "initiation": (lambda span, extremum, sign: K[0], {}),
    "direction": (
        lambda span, extremum, sign: sum(K) * (2.4 if sign > 0 else 2.0) / 2.2 - sum(K[1:]),
        {"direction-asymmetry": {"ratio": 1.2}},
    ),
}


def lawful(name):
    _, values = LAWS[name]
    replaced = any("offset" in v for v in values.values())
    later = table([0.0, *K[1:]]) if replaced else table(K)
    stages = [CAUSES["initiation-stage"].of(table(FIRST))]
    stages += [CAUSES[id].of(**v) for id, v in values.items()]
    assert {type(s) for s in stages} == set(named_model(name))
    return Model((Maxwell.of(later), *stages))
