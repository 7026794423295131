"""Knocks that come once raise the noise of everything; they are said to be no steady noise."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.bursts import Bursts, bursts
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification import identify, prepare
from piezo_rig.studies.hidden import draw
from tests.diagnosis.two_drives import session

module = sys.modules["piezo_rig.diagnosis.bursts"]


def steady(number, time):
    return 0.0 * time


def knocked(sweeps, size_um):
    """A knock that rings at 37 Hz for a tenth of a second, in one of the recordings."""
    time = np.arange(sweeps[2].sensor_v.size) / sweeps[2].sample_rate
    since = np.maximum(time - 1.37, 0.0)
    knock = size_um * np.where(time > 1.37, np.exp(-since / 0.1) * np.sin(232.0 * since), 0.0)
    return [s.with_(sensor_v=s.sensor_v + knock) if k == 2 else s for k, s in enumerate(sweeps)]


def found(sweeps):
    groups = group_tracks(prepare(sweeps), sweeps)
    return bursts(groups, identify(sweeps, "classical").model)


@pytest.mark.parametrize("colour", ["white", "ar"])
@pytest.mark.parametrize("seed", [
    0, *(pytest.param(seed, marks=pytest.mark.study) for seed in range(1, 8)),
])  # fmt: skip
def test_steady_noise_has_no_bursts(colour, seed):
    assert found(session(seed, colour, steady)) is None


def test_a_gain_that_wanders_is_no_burst():
    assert found(session(0, "white", lambda number, time: 1e-3 * np.sin(0.1 * time))) is None


def test_a_knock_is_found_where_it_is():
    told = found(knocked(session(0, "white", steady), 0.1))
    assert 4 <= told.count <= 10  # stretches of 32 ms, from 100 nm down to a few times 2 nm
    assert {name for name, _ in told.at} == {"to 70 V"}
    assert all(1.3 < seconds < 1.5 for _, seconds in told.at)
    # 0.1 um sin, decaying in 0.1 s: a quarter of 0.1^2 x 0.1 s, of six recordings of four seconds
    assert told.rms_nm == pytest.approx(1e3 * np.sqrt(0.25 * 0.1**2 * 0.1 / 24.0), rel=0.15)


def test_a_slow_knock_is_found_in_longer_stretches():
    """A knock that rings at 4 Hz for a second is hardly more than a trend within 32 ms."""
    sweeps = session(3, "white", steady)
    time = np.arange(sweeps[2].sensor_v.size) / sweeps[2].sample_rate
    since = np.maximum(time - 1.5, 0.0)
    knock = 0.02 * np.where(time > 1.5, np.exp(-since / 0.8) * np.sin(2 * np.pi * 4.0 * since), 0.0)
    told = found([
        s.with_(sensor_v=s.sensor_v + knock) if k == 2 else s for k, s in enumerate(sweeps)
    ])
    assert {name for name, _ in told.at} == {"to 70 V"}
    assert all(1.3 < seconds < 3.5 for _, seconds in told.at)


@pytest.mark.parametrize(("rms_nm", "told"), [
    ({32: 0.4, 128: 4.7}, 128),  # of a knock at 7 Hz, most is a trend in a short stretch
    ({32: 4.1, 128: 4.7}, 32),
    ({16: 1.0, 512: 1.2}, 16), ({512: 0.2}, 512), ({}, None),
])  # fmt: skip
def test_a_knock_counts_for_nearly_as_much_as_it_is(monkeypatch, rms_nm, told):
    every = {long: Bursts(1, 5.0, rms, (("decay", 7.0),)) for long, rms in rms_nm.items()}
    monkeypatch.setattr(module, "_of_length", lambda groups, model, long, degree: every.get(long))
    groups = group_tracks(prepare(session(0, "white", steady)), session(0, "white", steady))
    assert bursts(groups, None) is every.get(told)


@pytest.mark.parametrize(("places", "known"), [
    ([("decay", 5.157)], True), ([("decay", 5.157), ("decay", 7.0)], True),
    ([("decay", 5.4)], False), ([("steps", 5.157)], False), ([], False),
])  # fmt: skip
def test_what_is_loud_where_samples_were_lost_is_known(places, known):
    assert Bursts(1, 2.8, 1.2, (("decay", 5.12),), 0.1).all_at(places) == known
    two = Bursts(2, 2.8, 1.2, (("decay", 5.12), ("decay", 7.02)), 0.1)
    assert two.all_at([("decay", 5.157), ("decay", 7.0)])
    assert not two.all_at([("decay", 5.157)])
    assert not Bursts(5, 2.8, 1.2, (("decay", 5.12),), 0.1).all_at(places)  # others are not told


def test_a_diagnosis_calls_it_unexplained_and_names_no_cause():
    out = diagnose(knocked(session(1, "white", steady), 0.1))
    assert out.findings == []
    assert out.unexplained.detected
    assert "clock" in out.unexplained.depends_on
    assert "noise is not steady" in out.unexplained.text


def test_spikes_that_were_missed_are_no_bursts():
    rng = np.random.default_rng(5)
    sweeps = session(2, "white", steady)
    spiked = []
    for s in sweeps:
        volts = s.sensor_v.copy()
        volts[rng.integers(100, volts.size - 100, 6)] += 0.025 * rng.choice([-1.0, 1.0], 6)
        spiked.append(s.with_(sensor_v=volts))
    assert found(spiked) is None


@pytest.mark.parametrize("seed", [9300, 9301])
def test_of_few_stretches_of_slow_noise_none_is_a_burst(seed):
    """Some thirty long stretches of 1/f noise know badly how much they scatter."""
    assert found(draw("null", seed, "holds", "1/f", 40.0, 2).sweeps) is None
