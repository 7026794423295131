"""Gains that differ between recordings are no noise; noise of any colour is no gain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.engine import noise_of, plainly
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.noise import Spectrum
from piezo_rig.diagnosis.unexplained import Unexplained, unexplained
from piezo_rig.diagnosis.unsteady import Unsteady, unsteady, unsteady_cycles
from piezo_rig.diagnosis.whitening import CellWhitener
from piezo_rig.identification import prepare
from piezo_rig.run_file.sweep import Sweep
from tests.diagnosis.sliders import play, recorded
from tests.diagnosis.two_drives import LIMITS, noise, session
from tests.more import first_of


@pytest.mark.study
@pytest.mark.parametrize("colour", ["white", "ar"])
@pytest.mark.parametrize("gain", [
    lambda number, time: 0.004 * (number >= 4), lambda number, time: 0.006 * np.sin(0.9 * time),
], ids=["a step", "a wave"])  # fmt: skip
def test_what_follows_the_displacement_is_unexplained(colour, gain):
    found = diagnose(session(5, colour, gain)).unexplained
    assert found.detected
    assert "is not steady" in found.text
    assert {"displacement", "clock"} <= set(found.depends_on)


@pytest.mark.study
@pytest.mark.parametrize("colour", ["white", "ar"])
@pytest.mark.parametrize("seed", [1, 2])
def test_noise_is_not(colour, seed):
    assert "is not steady" not in diagnose(session(seed, colour, lambda *_: 0.0)).unexplained.text


def test_what_all_repeats_agree_on_is_unexplained_whatever_it_looks_like():
    """Errors of recordings that were left out, against what their repeats differ by."""
    plain = diagnose(session(7, "white", lambda *_: 0.0))
    assert not plain.unexplained.detected
    space, last, floor = plain.workings.space, plain.workings.last, plain.noise_floor_nm

    def of(held_out_nm: float) -> Unexplained:
        return unexplained(space, last, floor, 0.0, np.random.default_rng(0), held_out_nm)

    assert not of(1.1 * floor).detected
    found = of(2.0 * floor)
    assert found.detected
    assert found.rms_nm == pytest.approx(np.sqrt(3.0) * floor)
    assert found.depends_on


def test_where_nothing_moves_nothing_is_unsteady():
    sweeps = session(1, "white", lambda *_: 0.0)
    groups = group_tracks(prepare(sweeps), sweeps)
    model = starting_model(groups, (), "classical")
    still = groups.with_([replace(g, drive_v=np.full_like(g.drive_v, 5.0)) for g in groups.groups])
    white = CellWhitener(Spectrum(np.array([1e-6, 0.5]), np.log([4e-6, 4e-6]), np.zeros(2)))
    found = unsteady(still, white, model)
    assert found.p_value == 1.0
    assert found.rms_nm == 0.0


def walks(gain) -> list[Sweep]:
    """One random walk of 12 s, twice; ``gain`` : of time on the bench, what the sensor shows."""
    rng, rate = np.random.default_rng(4), 500.0
    time = np.arange(6000) / rate
    corners = np.cumsum(rng.uniform(0.08, 0.4, 60))
    volts = np.interp(time, np.append(0.0, corners), np.append(0.0, rng.uniform(0.0, 75.0, 60)))
    out = []
    for repeat in range(2):
        moved = play(volts, LIMITS, 0.0016) * (1.0 + gain(31.0 * repeat + time))
        seen = moved + 3e-3 * rng.standard_normal(time.size)
        out.append(Sweep(
            f"sweep_{repeat + 1:04d}", volts, seen, rate, 1.0, 0.0, 1.0, 1, 0.0, "a walk",
            repeat + 1, "virgin", 31.0 * repeat, "SIMULATED",
        ))  # fmt: skip
    return out


def wave(time):
    return 0.004 * np.sin(2.0 * np.pi * time / 7.3)


def of_walks(gain) -> Unsteady:
    """With the noise as two repeats show it, which has the wave in it."""
    sweeps = walks(gain)
    groups = group_tracks(prepare(sweeps), sweeps)
    start = Point(starting_model(groups, (), "classical"))
    whitener, _ = noise_of(groups, start, np.random.default_rng(0))
    found = unsteady(groups, whitener, plainly(groups, start).point.model)
    assert found is not None
    return found


def test_a_gain_that_waves_through_a_random_walk_is_seen():
    found, time = of_walks(wave), np.arange(6000) / 500.0
    differ = 0.5 * np.std(wave(time) - wave(31.0 + time))  # of either from their mean
    assert found.p_value < 1e-4
    assert found.share == pytest.approx(differ, rel=0.3)


def test_a_steady_gain_in_a_random_walk_is_none():
    assert of_walks(lambda time: 0.0 * time).p_value > 0.01


def cycles(gain, colour="white", seed=8, cycle_hz=2.5) -> Unsteady | None:
    """25 triangles in one recording of 10 s; ``gain`` : of time, what the sensor shows."""
    rng, rate = np.random.default_rng(seed), 1000.0
    time = np.arange(10_000) / rate
    volts = 75.0 * (1.0 - np.abs(2.0 * ((cycle_hz * time) % 1.0) - 1.0))
    seen = play(volts, LIMITS, 0.0016) * (1.0 + gain(time))
    sweeps = [recorded(volts, seen + 4e-3 * noise(rng, time.size, colour), rate)]
    groups = group_tracks(prepare(sweeps), sweeps)
    start = Point(starting_model(groups, (), "classical"))
    start = plainly(groups, start).point
    whitener, _ = noise_of(groups, start, rng)
    return unsteady_cycles(groups, whitener, start.model)


@pytest.mark.parametrize(("colour", "size"), [("white", 2e-3), ("ar", 4e-3)])
@pytest.mark.parametrize("cycle_hz", first_of(1, [3.3, 2.5]))  # 3.3: no whole number of samples
def test_a_gain_that_waves_from_cycle_to_cycle_is_seen(colour, size, cycle_hz):
    """In slow noise, of which there is much at its frequencies, a larger one."""
    found = cycles(lambda t: size * np.sin(2.0 * np.pi * 0.31 * t), colour, cycle_hz=cycle_hz)
    assert found.p_value < 1e-3
    assert found.share == pytest.approx(size / np.sqrt(2.0), rel=0.4)


@pytest.mark.parametrize("colour", ["white", "ar"])
@pytest.mark.parametrize("seed", first_of(1, range(4)))
def test_noise_is_no_gain_of_cycles(colour, seed):
    assert cycles(lambda t: 0.0 * t, colour, seed).p_value > 0.002


def test_too_few_cycles_say_nothing():
    assert cycles(lambda t: 0.0 * t, cycle_hz=0.4) is None
