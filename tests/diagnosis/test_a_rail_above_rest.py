"""An amplifier that does not come down to 0 V, and where the memory of its actuator was empty."""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from small_bench import CONDITIONS, actuator, recordings

from piezo_rig.causes.drive_clipping import DriveClipping
from piezo_rig.chain import Model
from piezo_rig.chain.elements import Elements
from piezo_rig.chain.maxwell import Maxwell
from piezo_rig.diagnosis import diagnose

RAIL = 0.6
THRESHOLDS = np.array([0.25, 0.9, 2.5, 6.0, 14.0, 30.0])
WEIGHTS = np.array([3.0, 2.0, 4.0, 3.0, 5.0, 6.0]) * 1e-3


def played(drive, at_v):
    """Play operators that were at rest at a drive, in um from the first sample."""
    states = np.full(THRESHOLDS.size, at_v)
    out = np.empty(drive.size)
    for k, v in enumerate(drive):
        states = np.minimum(np.maximum(states, v - THRESHOLDS), v + THRESHOLDS)
        out[k] = 0.09 * v + WEIGHTS @ states
    return out - out[0]


def model(**more):
    steps = 0.09 + np.append(0.0, np.cumsum(WEIGHTS))
    knots = np.append(THRESHOLDS, 200.0)
    table = Maxwell.of(Elements.from_curve(knots, steps))
    return Model((DriveClipping.of(None, lower=RAIL, upper=1000.0, **more), table))


@pytest.mark.parametrize(("more", "at_v"), [({"empty_at_v": 0.0}, 0.0), ({}, RAIL)])
def test_the_memory_is_empty_at_0_v_or_at_the_rail(more, at_v):
    turns = [0.0, 40.0, 0.0, 25.0, 5.0, 60.0, 0.0]
    drive = np.concatenate([np.linspace(a, b, 400) for a, b in pairwise(turns)])
    time = np.arange(drive.size) / 1000.0
    expected = played(np.maximum(drive, RAIL), at_v)
    assert np.allclose(model(**more).simulate(time, drive), expected, atol=1e-9)


def test_no_rail_in_the_way_shifts_nothing():
    drive = np.concatenate([np.linspace(0.0, 40.0, 500), np.linspace(40.0, 0.0, 500)])
    time = np.arange(drive.size) / 1000.0
    below = DriveClipping.of(None, lower=-0.5, upper=1000.0, empty_at_v=0.0)
    bare = Model((model().maxwell,))
    assert np.array_equal(
        bare.with_stage(below).simulate(time, drive), bare.simulate(time, drive)
    )


def of_memory(at_v):
    """Recordings at such an amplifier, of an actuator whose memory was empty at some drive."""
    played = {}

    def effect(x, drive, t):
        key = (drive.size, float(drive.max()), float(drive[drive.size // 2]))
        if key not in played:
            clipped = np.append(at_v, np.maximum(drive, RAIL))
            whole = actuator(seed=2)(clipped)[1:]
            played[key] = whole - whole[0]
        return played[key]

    return recordings(effect, seed=2, conditions=CONDITIONS[:2])


@pytest.mark.study
@pytest.mark.parametrize("at_v", [0.0, RAIL])
def test_a_first_rise_from_above_is_no_initiation_stage(at_v):
    found = diagnose(of_memory(at_v))
    assert [f.cause for f in found.findings] == ["drive-clipping"]
    low, high = found.findings[0].parameters["lower"].ci95
    assert low < RAIL < high
