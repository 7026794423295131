"""Recordings that no protocol of ours made: sinusoids, a random walk, a friction damper."""

from __future__ import annotations

import numpy as np
import pytest
from small_bench import RATE, drive_of

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.covered import covered
from piezo_rig.diagnosis.groups import group_tracks
from piezo_rig.identification import identify, prepare
from piezo_rig.run_file.sweep import Sweep


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
    rate, delay, rng = 1e4, 3e-4, np.random.default_rng(3)
    piece = np.arange(0.0, 0.25, 1.0 / rate)
    drive = np.concatenate([40.0 * np.sin(2 * np.pi * f * piece) for f in (20.0, 50.0, 100.0)])
    y = 0.3 * drive + plays(drive, np.linspace(0.5, 39.0, 24), np.full(24, 0.025))
    time = np.arange(drive.size) / rate
    seen = np.interp(time - delay, time, y) + 3e-3 * rng.standard_normal(drive.size)
    found = diagnose([alone(drive, seen, rate)])
    (one,) = found.findings
    assert one.cause == "time-skew"
    low, high = one.parameters["delay"].ci95
    assert low <= delay <= high
    assert high - low < 2e-6
    assert found.rungs[-1].rms_nm == pytest.approx(3.0, rel=0.15)
    assert not found.unexplained.detected


def walk(seed, every=1, history="unknown", noise_um=2e-3, sensor=None, samples=6000):
    """A random walk that turns every so many samples, on sliders that begin at rest."""
    rng = np.random.default_rng(seed)
    steps = np.cumsum(rng.standard_normal(samples // every)) * 0.3 * np.sqrt(every)
    drive = np.interp(np.arange(samples) / every, np.arange(steps.size), steps - steps[0])
    y = 0.1 * drive + plays(drive, np.linspace(0.5, 20.0, 20), np.full(20, 0.01))
    if sensor is not None:
        y = sensor(y, np.arange(samples) / 1e3)
    seen = y + noise_um * rng.standard_normal(samples)
    return alone(drive, seen, 1e3).with_(history=history)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_random_walk_of_unknown_history_is_modelled_down_to_its_noise(seed):
    # its largest loops are closed in passing by half loops that are far shorter, and in the last
    # third it goes further than ever before
    sweep = walk(seed)
    assert identify([sweep], "classical").fitted.rms_nm == pytest.approx(2.0, rel=0.1)
    found = diagnose([sweep])
    assert found.findings == []
    assert not found.unexplained.detected
    assert found.rungs[0].rms_nm == pytest.approx(2.0, rel=0.1)


def test_drift_is_found_in_a_random_walk():
    (drift,) = diagnose([walk(30, 10, sensor=lambda x, t: x + 10e-3 * t)]).findings
    assert drift.cause == "thermal-drift"
    low, high = drift.parameters["rate"].ci95
    assert abs(10.0 - 0.5 * (low + high)) < 1.5 * 0.5 * (high - low)


def test_hum_is_found_where_the_drive_may_turn_once_a_period():
    sensor = lambda x, t: x + 2e-3 * np.sin(2.0 * np.pi * 50.0 * t + 0.3)  # noqa: E731
    (hum,) = diagnose([walk(30, 10, sensor=sensor)]).findings
    assert hum.cause == "mains-hum"
    assert hum.parameters["amplitude"].value == pytest.approx(2.0, abs=0.15)


def test_what_goes_further_than_before_is_not_scored():
    sweep = walk(4, history="virgin")
    (group,) = group_tracks(prepare([sweep]), [sweep]).groups
    begin = 4000
    kept = covered(group, begin)
    drive = sweep.drive_v
    assert 0.1 * (drive.size - begin) <= sum(b - a for a, b in kept) < drive.size - begin
    high, low = drive[:begin].max(), drive[:begin].min()
    beyond = (drive > high + 0.02 * np.ptp(drive)) | (drive < low - 0.02 * np.ptp(drive))
    new = np.flatnonzero(beyond & (np.maximum.accumulate(np.abs(drive)) == np.abs(drive)))
    assert new.size
    assert not any(a <= i < b for i in new for a, b in kept)
    steady = drive_of(0.0, 50.0, cycles=6)
    same = alone(steady, 0.1 * steady, RATE).with_(history="virgin")
    (group,) = group_tracks(prepare([same]), [same]).groups
    assert covered(group, begin) == [(begin, steady.size)]


def test_a_friction_damper_is_what_the_model_says():
    time, rng = np.arange(0.0, 16.0, 2e-3), np.random.default_rng(3)
    drive = 10.0 * np.sin(np.pi * time) * (1.0 + 0.5 * np.sin(2 * np.pi * 0.06 * time))
    force = np.zeros(time.size)
    for limit, stiffness in ((1.0, 3.0), (2.0, 2.0), (4.0, 1.0)):
        s = 0.0
        for i in range(1, time.size):
            s = float(np.clip(s + drive[i] - drive[i - 1], -limit, limit))
            force[i] += stiffness * s
    found = diagnose([alone(drive, force + 0.02 * rng.standard_normal(time.size), 500.0)])
    assert found.findings == []
    assert found.rungs[0].max_percent < 2.0
