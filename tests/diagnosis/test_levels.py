"""Noise that switches between two levels, and what must not be taken for it."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.early.clean_up import clean_up
from piezo_rig.diagnosis.engine import plainly
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.levels import levels
from piezo_rig.identification import prepare
from tests.diagnosis.sliders import play, recorded
from tests.diagnosis.two_drives import LIMITS, NOISE_UM, RATE, noise, session
from tests.more import first_of

STEP_UM = 0.012


def steady(number, time):
    return 0.0 * time


def with_(sweeps, added):
    """The recordings with something that their sensor adds: of number and samples."""
    return [
        s.with_(sensor_v=s.sensor_v + added(k, s.sensor_v.size)) for k, s in enumerate(sweeps)
    ]


def switching(seed, dwell_s, step_um=STEP_UM):
    """Up and down at random, so many seconds at each on the average."""
    rng = np.random.default_rng(seed)
    return lambda k, n: step_um * (np.cumsum(rng.random(n) < 1e-3 / dwell_s) % 2)


def found(sweeps):
    return levels(group_tracks(prepare(sweeps), sweeps))


@pytest.mark.parametrize("colour", ["white", "ar"])
@pytest.mark.parametrize("dwell_s", [0.15, 0.5])
@pytest.mark.parametrize("seed", first_of(1, range(3)))
def test_how_far_apart_they_are_and_how_often_they_change(colour, dwell_s, seed):
    told = found(with_(session(seed, colour, steady), switching(seed, dwell_s)))
    assert told.step_nm == pytest.approx(1e3 * STEP_UM, rel=0.15)
    assert told.per_second == pytest.approx(1.0 / dwell_s, rel=0.5)


@pytest.mark.parametrize("colour", ["white", "ar"])
@pytest.mark.parametrize("seed", first_of(2, range(8)))
def test_noise_has_no_levels(colour, seed):
    assert found(session(seed, colour, steady)) is None


@pytest.mark.parametrize("added", [
    lambda k, n: 0.05 * (np.arange(n) > 1500) * (k == 2),  # one step
    lambda k, n: switching(k, 0.5, 0.0791)(k, n),  # fringes
    lambda k, n: 0.012 * np.sin(2.0 * np.pi * 11.3 * np.arange(n) / 1000.0 + k),  # a tone
    lambda k, n: 0.02 * k * np.arange(n) / n,  # drifts
    lambda k, n: 1e-3 * np.cumsum(np.random.default_rng(k).standard_normal(n)),  # a walk
])  # fmt: skip
def test_neither_have_steps_of_other_kinds(added):
    assert found(with_(session(0, "white", steady), added)) is None


@pytest.mark.parametrize("lost", [1, 3, 20])
def test_lost_samples_turn_over_with_the_drive_and_are_no_levels(lost):
    sweeps = session(0, "white", steady)
    cut = [np.append(np.delete(s.sensor_v, range(900, 900 + lost)), np.full(lost, s.sensor_v[-1]))
           if k % 3 == 0 else s.sensor_v for k, s in enumerate(sweeps)]  # fmt: skip
    assert found([s.with_(sensor_v=c) for s, c in zip(sweeps, cut, strict=True)]) is None


@pytest.mark.parametrize("lost", first_of(1, [3, 7]))
@pytest.mark.parametrize("colour", first_of(1, ["ar", "white"]))
def test_what_lost_samples_leave_of_a_smooth_wave_are_no_levels(colour, lost):
    """It goes like the drive's acceleration, and peaks where the drive turns slowly."""
    sweeps = waves(colour, lost)
    assert found(sweeps) is None
    out = diagnose(sweeps)
    assert [f.cause for f in out.findings] == ["dropped-samples"]
    assert out.findings[0].parameters["count"].value == lost


def waves(colour, lost):
    """Three recordings of a sine that grows and shrinks, the second with a loss."""
    rng, n = np.random.default_rng(7), 5000
    grown = np.concatenate([np.linspace(0.15, 1.0, n // 2), np.linspace(1.0, 0.15, n - n // 2)])
    volts = 36.0 * grown * (1.0 - np.cos(2.0 * np.pi * 4.0 * np.arange(n) / RATE))
    moved, out = play(volts, LIMITS, 0.0016), []
    for number in range(3):
        seen = moved + NOISE_UM * noise(rng, n, colour)
        if number == 1:
            seen = np.append(np.delete(seen, range(1800, 1800 + lost)), np.full(lost, seen[-1]))
        out.append(recorded(volts, seen, RATE, "virgin", number))
    return out


def loops_with_a_loss(at, lost):
    """Two triangles of one frequency three times each; the second recording of one has a loss."""
    rng, time = np.random.default_rng(1), np.arange(4000) / 2000.0
    out = []
    for number in range(6):
        top = (70.0, 45.0)[number % 2]
        volts = top * (1.0 - np.abs(2.0 * ((1.5 * np.maximum(time - 0.1, 0.0)) % 1.0) - 1.0))
        seen = play(volts, LIMITS, 0.0016) + NOISE_UM * rng.standard_normal(time.size)
        if number == 2:
            seen = np.delete(seen, range(at, at + lost))
        out.append(recorded(
            volts[: seen.size], seen, 2000.0, number=number, condition=f"to {top:g} V",
            repeat=number // 2 + 1,
        ))  # fmt: skip
    return out


@pytest.mark.parametrize("at", first_of(1, [1300, 1500]))
def test_what_a_loss_leaves_of_every_half_loop_is_no_telegraph(at):
    """In parts it is: averages that stand out here and there, up and down, and much the same."""
    sweeps = loops_with_a_loss(at, 7)
    groups = group_tracks(prepare(sweeps), sweeps)
    assert levels(groups) is not None
    point = plainly(groups, Point(starting_model(groups, (), "classical"))).point
    early, _ = clean_up(groups, sweeps, point, lambda g, p: plainly(g, p).point, 1e-3, 20)
    assert [e.cause for e in early] == ["dropped-samples"]
    (event,) = early[0].events
    assert (event.index, event.size) == (at, 7)
    assert levels(early[0].groups) is None


def test_a_diagnosis_says_so_and_names_no_lost_samples():
    out = diagnose(with_(session(1, "white", steady), switching(1, 0.15)))
    assert out.findings == []
    assert out.unexplained.detected
    assert "clock" in out.unexplained.depends_on
    assert "two levels" in out.unexplained.text
