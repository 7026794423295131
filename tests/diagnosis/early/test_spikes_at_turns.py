"""A sensor that ends just below the tops of one recording cuts one sample off each: no spike."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.diagnosis.early.spikes import find_spikes
from piezo_rig.diagnosis.fit import starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification import prepare
from tests.diagnosis.sliders import play, recorded

RATE, NOISE_UM, LIMITS = 5000.0, 2e-3, np.linspace(0.5, 30.0, 60)
CYCLES, SAMPLES = 20, 250


def spikes_of(rows, drive, rate=RATE):
    """Events of recordings of one drive, of which the model knows the actuator."""
    sweeps = [recorded(drive, row, rate, number=k + 1, condition="a", repeat=k + 1)
              for k, row in enumerate(rows)]  # fmt: skip
    groups = group_tracks(prepare(sweeps), sweeps)
    model = starting_model(groups, (), "classical")
    (group,) = groups.groups
    off = play(group.drive_v, LIMITS, 0.0009) - group.predicted(model)
    known = groups.with_([group.with_measured(group.measured_um - off)])
    return [(s.row, s.index) for s in find_spikes(known, model).spikes]


@pytest.mark.parametrize("cut_um", [0.03, 0.015])  # of the last not all are tall
@pytest.mark.parametrize("beside", [[], [(0, 1111), (1, 333)]])
def test_tops_that_are_cut_in_one_of_two_recordings_are_none(beside, cut_um):
    drive = 70.0 * (1.0 - np.abs(2.0 * ((np.arange(CYCLES * SAMPLES) / SAMPLES) % 1.0) - 1.0))
    moved, rng = play(drive, LIMITS, 0.0009), np.random.default_rng(4)
    rows = [moved, np.minimum(moved, moved.max() - cut_um)]
    rows = [row + NOISE_UM * rng.standard_normal(drive.size) for row in rows]
    for number, at in beside:
        rows[number][at] += 0.2
    assert spikes_of(rows, drive) == beside


@pytest.mark.parametrize("beside", [[], [(0, 11111), (0, 34000)]])
def test_the_crests_of_ringing_that_no_model_has_are_none(beside):
    """Every one stands off the samples around it, and is reached and left by steps like its own."""
    rate, size = 20000.0, 40000
    t = np.arange(size) / rate
    drive = 70.0 * (1.0 - np.abs(2.0 * (t % 1.0) - 1.0))
    rung = np.maximum(t - 0.9, 0.0)
    seen = play(drive, LIMITS, 0.0009)
    seen = seen + 3.0 * np.exp(-rung / 0.015) * np.sin(2.0 * np.pi * 412.0 * rung)
    seen = seen + NOISE_UM * np.random.default_rng(4).standard_normal(size)
    for _, at in beside:
        seen[at] += 0.2
    assert spikes_of([seen], drive, rate) == beside
