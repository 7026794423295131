"""What a sweep shows of its own faults, on sweeps made here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from piezo_rig.config import load_rig
from piezo_rig.sweep_watch import error_of, look

RIG = load_rig()  # 15.48 um/V, 1 V range, 0.15 um per V of drive
UP = np.linspace(0.0, 75.0, 1251)
DRIVE = np.concatenate([UP, UP[-2::-1], UP[1:], UP[-2::-1]])  # 0-75 V, 300 V/s at 5 kSa/s
NOISE = np.random.default_rng(7).normal(0.0, 2e-3, DRIVE.size)  # um
TRAVEL = 0.13 * DRIVE + NOISE


def volts(um: np.ndarray) -> np.ndarray:
    return -um / 15.48


def codes(um=TRAVEL, monitor=DRIVE, rig=RIG, drive=DRIVE) -> dict[str, object]:
    return {flag.code: flag for flag in look(rig, drive, volts(um), monitor)}


def test_a_good_sweep_has_no_flags():
    assert codes() == {}
    assert codes(monitor=None) == {}


def test_sweeps_without_motion_or_with_very_little_have_no_flags():
    still = np.zeros(500)
    assert codes(NOISE[:500], still, drive=still) == {}
    little = np.concatenate([np.linspace(0, 2, 200), np.linspace(2, 0, 200)])
    assert codes(0.1 * little + NOISE[:400], little, drive=little) == {}


def test_a_hysteretic_loop_with_spikes_drift_and_jumps_of_the_count_has_no_flags():
    bent = TRAVEL + 0.6 * np.sin(np.pi * DRIVE / 75.0) * np.sign(np.gradient(DRIVE))
    bent += np.linspace(0.0, 0.05, DRIVE.size) + 0.0791 * (np.arange(DRIVE.size) > 1700)
    bent[[400, 1500, 1501, 3000]] += [0.3, -0.5, 0.2, 0.8]
    assert codes(bent) == {}


@pytest.mark.parametrize("level_v", [0.0, 0.02, 1.0, -1.0])
@pytest.mark.parametrize(("first", "count"), [(600, 25), (600, 300), (2000, 100)])
def test_a_beam_that_is_lost_for_a_while_is_flagged_where_it_was(level_v, first, count):
    um = TRAVEL.copy()
    um[first : first + count] = -15.48 * level_v
    um[first + count :] += 0.2
    found = codes(um)
    assert list(found) == ["beam-interruption"]
    flag = found["beam-interruption"]
    assert (flag.first, flag.count) == (first, count)
    assert not flag.stops
    assert not flag.usable


def test_a_beam_that_does_not_come_back_stops_the_run():
    um = TRAVEL.copy()
    um[3000:] = 0.1
    assert codes(um)["beam-interruption"].stops
    assert codes(np.full(DRIVE.size, 0.3))["beam-interruption"].stops


def test_an_output_at_its_stop_stops_the_run_and_a_noisy_plateau_does_not():
    cut = codes(np.minimum(TRAVEL, 8.0))["sensor-clipping"]
    assert cut.stops
    assert not cut.usable
    plateau = codes(np.minimum(0.13 * DRIVE, 8.0) + NOISE)["sensor-clipping"]
    assert not plateau.stops
    assert plateau.usable
    # 8 um is reached at 61.54 V, 1026 samples after the start; both rises and falls are cut.
    assert plateau.first == pytest.approx(1026, abs=20)


def test_a_digitizer_range_that_is_too_small_stops_the_run():
    small = replace(RIG, digitizer=replace(RIG.digitizer, sensor_range_v=0.5))
    um = np.minimum(TRAVEL, 0.5 * 15.48)
    assert codes(um, rig=small)["sensor-clipping"].stops


def test_an_amplifier_that_stops_short_is_flagged_and_the_sensor_is_not_blamed():
    reached = np.minimum(DRIVE, 70.0)
    found = codes(0.13 * reached + NOISE, reached)
    assert list(found) == ["drive-clipping"]
    assert not found["drive-clipping"].stops


def test_an_amplifier_that_is_too_slow_does_not_look_like_a_switch_that_was_turned():
    slow = np.empty_like(DRIVE)
    slow[0] = 0.0
    for k in range(1, DRIVE.size):  # 60 V/s at most
        slow[k] = slow[k - 1] + np.clip(DRIVE[k] - slow[k - 1], -0.012, 0.012)
    assert codes(0.13 * slow + NOISE, slow) == {}


@pytest.mark.parametrize("factor", [0.25, 4.0, 0.0])
def test_a_switch_that_stands_elsewhere_or_no_sensor_at_all_stops_the_run(factor):
    wide = replace(RIG, digitizer=replace(RIG.digitizer, sensor_range_v=16.0))
    found = codes(factor * 0.13 * DRIVE + NOISE, rig=wide)
    assert list(found) == ["sensor-sensitivity" if factor else "beam-interruption"]
    assert all(flag.stops for flag in found.values())


def test_a_switch_that_is_turned_within_a_sweep_is_seen_in_the_next_half_loop():
    um = TRAVEL * np.where(np.arange(DRIVE.size) > 2000, 0.25, 1.0)
    assert codes(um)["sensor-sensitivity"].first == 2500


def test_oversampled_sweeps_are_looked_at_the_same_way():
    fast = replace(RIG, digitizer=replace(RIG.digitizer, oversampling=10))
    um = np.repeat(TRAVEL, 10)
    um[6000:7000] = 0.0
    found = {flag.code: flag for flag in look(fast, DRIVE, volts(um), np.repeat(DRIVE, 10))}
    assert found["beam-interruption"].first == 600


def test_a_run_ends_with_an_error_only_for_sweeps_that_count():
    flags = [
        {"event": "flag", "code": "drive-clipping", "sweep": "sweep_0002", "what": "x"},
        {"event": "flag", "code": "sensor-clipping", "sweep": "sweep_0003", "what": "y",
         "usable": True},
        {"event": "playing", "sweep": "sweep_0004"},
    ]  # fmt: skip
    error = error_of(flags, ["sweep_0002", "sweep_0003"])
    assert error is not None
    assert error.code == "drive-clipping"
    assert "sweep_0002" in error.what
    assert error_of(flags, ["sweep_0003"]) is None
    assert error_of([], ["sweep_0002"]) is None
