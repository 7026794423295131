"""Recordings that no protocol of ours made: sinusoids, a random walk, a friction damper."""

from __future__ import annotations

import re

import numpy as np
import pytest
from small_bench import RATE, drive_of, relaxation

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.covered import covered
from piezo_rig.diagnosis.early.spikes import find_spikes
from piezo_rig.diagnosis.engine import _centred
from piezo_rig.diagnosis.grouping import group_tracks
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


@pytest.mark.study
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


@pytest.mark.study
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


@pytest.mark.study
def test_drift_is_found_in_a_random_walk():
    (drift,) = diagnose([walk(30, 10, sensor=lambda x, t: x + 10e-3 * t)]).findings
    assert drift.cause == "thermal-drift"
    low, high = drift.parameters["rate"].ci95
    assert abs(10.0 - 0.5 * (low + high)) < 1.5 * 0.5 * (high - low)


@pytest.mark.study
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


def growing(seed, effect=None):
    """Triangles of 2 Hz that grow from 5 to 75 V in one recording, from rest."""
    drive = np.concatenate([drive_of(0.0, float(high), cycles=1)[:-1] for high in range(5, 80, 5)])
    rng = np.random.default_rng(seed)
    y = 0.1 * drive + plays(drive, np.sort(rng.uniform(0.2, 36.0, 60)), np.full(60, 2e-3))
    if effect is not None:
        y = effect(y)
    return alone(drive, y + 2e-3 * rng.standard_normal(drive.size), RATE).with_(history="virgin")


@pytest.mark.study
def test_where_the_drive_only_grows_nothing_is_held_out_and_nothing_is_extrapolated():
    found = diagnose([growing(1)])
    assert found.findings == []
    assert not found.unexplained.detected
    assert found.held_out == "none"
    assert any("go further than all before" in note for note in found.notes)
    assert found.rungs[0].rms_nm == pytest.approx(2.0, rel=0.1)


@pytest.mark.study
def test_creep_is_found_where_the_drive_only_grows():
    def creeps(y):
        return y + sum(2.5e-3 * (relaxation(y, tau) - y) for tau in np.geomspace(0.01, 100.0, 9))

    found = diagnose([growing(1, lambda y: y + creeps(y))])
    assert [f.cause for f in found.findings] == ["creep"]
    assert found.findings[0].gain_percent is None
    assert found.rungs[-1].rms_nm == pytest.approx(2.0, rel=0.1)


@pytest.mark.study
@pytest.mark.parametrize(("hz", "seen"), [(23.3, True), (None, False)])
def test_a_tone_that_stands_alone_is_unexplained_without_repeats(hz, seen):
    def sensor(x, t):
        return x if hz is None else x + 6e-3 * np.sin(2.0 * np.pi * hz * t)

    rest = diagnose([walk(3, 10, sensor=sensor)]).unexplained
    assert rest.detected is seen
    assert ("frequency" in rest.depends_on) is seen
    if seen:
        assert rest.rms_nm == pytest.approx(6.0 / np.sqrt(2.0), rel=0.25)
        (told,) = re.findall(r"line at ([\d.]+) Hz", rest.text)
        assert float(told) == pytest.approx(hz, abs=0.15)


def test_a_small_part_of_the_range_is_enough_where_it_is_most_of_the_recording():
    """From one end to the other in a tenth of a second, then loops within a sixth of that."""
    rng = np.random.default_rng(2)
    turns = np.concatenate([[70.0, 0.0], 6.0 + np.cumsum(rng.uniform(-4.0, 4.0, 40)) * 0.3])
    at = np.concatenate([[0.0, 0.1], 0.2 + 0.1 * np.arange(40)])
    drive = np.interp(np.arange(4000) / 1e3, at, turns)
    y = 0.1 * drive + plays(drive, np.linspace(0.5, 20.0, 20), np.full(20, 0.01))
    sweep = alone(drive, y + 2e-3 * rng.standard_normal(drive.size), 1e3)
    assert identify([sweep], "classical").fitted.rms_nm == pytest.approx(2.0, rel=0.1)


def test_where_the_drive_leaps_an_error_of_the_model_is_no_spike():
    """Slow loops with two leaps of 8 V a sample, seen half a millisecond late."""
    rng = np.random.default_rng(4)
    drive = np.tile([10.0, 50.0], 3)
    at = np.array([0.0, 1.0, 1.005, 2.0, 2.005, 3.0])
    drive = np.interp(np.arange(4000) / 1e3, at, drive)
    drive = drive + 5.0 * np.sin(2.0 * np.pi * 3.0 * np.arange(4000) / 1e3)
    y = 0.1 * drive + plays(drive, np.linspace(0.5, 20.0, 20), np.full(20, 0.01))
    late = np.interp(np.arange(4000) - 0.5, np.arange(4000), y)
    sweep = alone(drive, late + 2e-3 * rng.standard_normal(4000), 1e3).with_(history="virgin")
    groups = group_tracks(prepare([sweep]), [sweep])
    (group,) = groups.groups
    model = identify([sweep], "classical").model
    assert find_spikes(groups, model).spikes == ()
    hit = sweep.sensor_v.copy()
    hit[[600, 2500]] += 0.06
    spoilt = groups.with_([group.with_measured(group.measured_um + (hit - sweep.sensor_v))])
    assert [s.index for s in find_spikes(spoilt, model).spikes] == [600, 2500]


def test_a_column_that_does_not_change_is_none_whatever_rounding_makes_of_its_mean():
    # less its mean, a constant of 0.1 is some 1e-17 of one sign: it met the target's own mean
    same, other = np.full(4000, 0.1), np.linspace(0.0, 1.0, 4000)
    assert np.any(same - same.mean())
    left = _centred(np.array([same, other]))
    assert not left[0].any()
    assert left[1] == pytest.approx(other - 0.5)
