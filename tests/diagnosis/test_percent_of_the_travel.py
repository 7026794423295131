"""The largest error is in percent of all that a recording travels, not of a stretch of it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from piezo_rig.diagnosis import diagnose
from piezo_rig.run_file import Sweep
from tests.diagnosis.small_bench import RATE, actuator

NOISE_UM = 2e-3


def recordings() -> list[Sweep]:
    """Two recordings of a random drive after a full loop that was not recorded."""
    rng, play = np.random.default_rng(3), actuator(5)
    turns = np.concatenate([[0.0], rng.uniform(10.0, 60.0, 40), [75.0, 20.0, 0.0]])
    drive = np.concatenate([np.linspace(a, b, 100, endpoint=False)
                            for a, b in pairwise(turns)])  # fmt: skip
    whole = np.concatenate([np.linspace(0.0, 75.0, 300), np.linspace(75.0, 0.0, 300)])
    moved = play(np.concatenate([whole, drive]))[whole.size :]
    return [
        Sweep(f"sweep_{k:04d}", drive, moved + NOISE_UM * rng.standard_normal(drive.size), RATE,
              1.0, 0.0, 1.0, 1, 0.0, "walk", k, "unknown", 10.0 * k, "IMPORTED")
        for k in (1, 2)
    ]  # fmt: skip


def test_the_largest_error_is_no_more_than_noise_makes_it():
    sweeps = recordings()
    found = diagnose(sweeps)
    assert not found.findings
    travel = float(np.ptp(sweeps[0].displacement_um))
    assert found.rungs[-1].max_percent < 100.0 * 7.0 * NOISE_UM / travel
