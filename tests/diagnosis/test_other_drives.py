"""Recordings that no protocol of ours made: sinusoids, a random walk, a friction damper."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.run_file.sweep import Sweep

RNG = np.random.default_rng(3)


def plays(drive, radii, weights):
    """Play operators from rest, sample by sample."""
    y = np.zeros(drive.size)
    for r, w in zip(radii, weights, strict=True):
        x = 0.0
        for i, v in enumerate(drive):
            x = max(v - r, min(v + r, x))
            y[i] += w * x
    return y


def alone(drive, y, rate):
    """One recording of a CSV file."""
    return Sweep("sweep_0001", drive, y, rate, 1.0, 0.0, 1.0, 1, 0.0, "", 1, "unknown", 0.0,
                 "IMPORTED")  # fmt: skip


def test_a_delay_shows_on_three_sinusoids_and_their_harmonics_are_no_hum():
    rate, delay = 1e4, 3e-4
    piece = np.arange(0.0, 0.5, 1.0 / rate)
    drive = np.concatenate([40.0 * np.sin(2 * np.pi * f * piece) for f in (20.0, 50.0, 100.0)])
    y = 0.3 * drive + plays(drive, np.linspace(0.5, 39.0, 24), np.full(24, 0.025))
    time = np.arange(drive.size) / rate
    seen = np.interp(time - delay, time, y) + 3e-3 * RNG.standard_normal(drive.size)
    found = diagnose([alone(drive, seen, rate)])
    (one,) = found.findings
    assert one.cause == "time-skew"
    low, high = one.parameters["delay"].ci95
    assert low <= delay <= high
    assert high - low < 2e-6
    assert found.rungs[-1].rms_nm == pytest.approx(3.0, rel=0.15)
    assert not found.unexplained.detected


def test_a_random_walk_that_is_modelled_badly_has_no_spikes():
    drive = np.cumsum(RNG.standard_normal(6000)) * 0.3
    y = 0.1 * drive + plays(drive, np.linspace(0.5, 20.0, 20), np.full(20, 0.01))
    found = diagnose([alone(drive, y + 2e-3 * RNG.standard_normal(drive.size), 1e3)])
    assert "outliers" not in [f.cause for f in found.findings]


def test_a_friction_damper_is_what_the_model_says():
    time = np.arange(0.0, 16.0, 2e-3)
    drive = 10.0 * np.sin(np.pi * time) * (1.0 + 0.5 * np.sin(2 * np.pi * 0.06 * time))
    force = np.zeros(time.size)
    for limit, stiffness in ((1.0, 3.0), (2.0, 2.0), (4.0, 1.0)):
        s = 0.0
        for i in range(1, time.size):
            s = float(np.clip(s + drive[i] - drive[i - 1], -limit, limit))
            force[i] += stiffness * s
    found = diagnose([alone(drive, force + 0.02 * RNG.standard_normal(time.size), 500.0)])
    assert found.findings == []
    assert found.rungs[0].max_percent < 2.0
