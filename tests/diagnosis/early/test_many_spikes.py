"""Where spikes are many, the smaller ones among them are found too, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.diagnosis.early.spikes import find_spikes
from piezo_rig.diagnosis.fit import starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification import prepare
from piezo_rig.run_file.sweep import Sweep
from tests.diagnosis.sliders import play

RATE, NOISE_UM, PER_S, SECONDS = 1000.0, 2e-3, 5.0, 12.0
LIMITS = np.linspace(0.5, 30.0, 60)


def session(seed, repeats):
    """A drive some times, and where its spikes are: (recording, first sample, one past last)."""
    rng, out, where = np.random.default_rng(seed), [], []
    time = np.arange(round(SECONDS * RATE)) / RATE
    volts = 70.0 * (1.0 - np.abs(2.0 * ((0.5 * time) % 1.0) - 1.0))
    moved = play(volts, LIMITS, 0.0009)
    for number in range(repeats):
        spikes = np.zeros(time.size)
        for at in np.sort(rng.choice(time.size // 20 - 2, rng.poisson(PER_S * SECONDS), False)):
            begin, width = 20 * int(at) + 20, int(rng.integers(1, 4))
            spikes[begin : begin + width] = rng.choice([-1, 1]) * rng.uniform(0.016, 0.045)
            where.append((number, begin, begin + width))
        seen = moved + spikes + NOISE_UM * rng.standard_normal(time.size)
        out.append(Sweep(
            f"sweep_{number + 1:04d}", volts, seen, RATE, 1.0, 0.0, 1.0, 1, 0.0, "0-70",
            number + 1, "virgin", 60.0 * number, "SIMULATED",
        ))  # fmt: skip
    return out, where


@pytest.mark.parametrize("repeats", [1, 3])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nearly_all_are_found(seed, repeats):
    sweeps, where = session(seed, repeats)
    groups = group_tracks(prepare(sweeps), sweeps)
    # a model that knows the actuator: what is left is the noise and the spikes
    model = starting_model(groups, (), "classical")
    (group,) = groups.groups
    off = play(group.drive_v, LIMITS, 0.0009) - group.predicted(model)
    known = groups.with_([group.with_measured(group.measured_um - off)])
    found = find_spikes(known, model)
    places = [(s.row, s.index) for s in found.spikes]
    missed = [w for w in where
              if not any(r == w[0] and w[1] - 1 <= i <= w[2] for r, i in places)]  # fmt: skip
    false = [p for p in places
             if not any(p[0] == w[0] and w[1] - 1 <= p[1] <= w[2] for w in where)]  # fmt: skip
    assert len(missed) <= 0.05 * len(where)
    assert false == []
    assert found.stage()["per_second"] == pytest.approx(len(where) / SECONDS / repeats, rel=0.06)
