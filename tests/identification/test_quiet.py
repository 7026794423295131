"""Noise that a drive was recorded with is taken out; what the actuator follows is not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from piezo_rig.identification.quiet import quiet

RATE = 5000.0


def triangle(low=0.0, high=75.0, hz=2.0, seconds=2.2):
    phase = (np.arange(round(seconds * RATE)) / RATE * hz) % 1.0
    return low + (high - low) * (1.0 - np.abs(2.0 * phase - 1.0))


def sine(hz=3.0, seconds=2.0):
    return 37.0 + 37.0 * np.sin(2.0 * np.pi * hz * np.arange(round(seconds * RATE)) / RATE)


def holds(seed=3):
    return np.repeat(np.random.default_rng(seed).uniform(0.0, 75.0, 20), 500)


def noisy(drive, volts, seed=1):
    rng = np.random.default_rng(seed)
    return drive + volts * rng.standard_normal(drive.size), 0.13 * drive + 2e-3 * (
        rng.standard_normal(drive.size)
    )


@pytest.mark.parametrize("drive", [triangle(), triangle(0.0, 40.0, 40.0), sine(), holds()])
@pytest.mark.parametrize("volts", [0.003, 0.01])
def test_of_noise_on_a_drive_a_third_is_left(drive, volts):
    recorded, moved = noisy(drive, volts)
    found, sigma = quiet(recorded, moved)
    assert sigma == pytest.approx(volts, rel=0.1)
    assert np.std(found - drive) < 0.36 * volts


@pytest.mark.parametrize("drive", [triangle(), triangle(0.0, 40.0, 40.0)])
def test_turning_points_are_where_they_were(drive):
    recorded, moved = noisy(drive, 0.01)
    found, _ = quiet(recorded, moved)
    bend = np.flatnonzero(np.abs(np.diff(drive, 2)) > 1e-3) + 1
    assert np.std(found[bend] - drive[bend]) < 0.006
    assert np.max(np.abs(found[bend] - drive[bend])) < 0.025


def test_a_leap_stays_a_leap():
    drive = holds()
    found, _ = quiet(*noisy(drive, 0.003))
    leap = np.flatnonzero(np.abs(np.diff(drive)) > 1.0)
    for at in (leap, leap + 1):
        assert np.max(np.abs(found[at] - drive[at])) < 0.02


@pytest.mark.parametrize("drive", [triangle(), sine(), holds()])
def test_a_clean_drive_stays_as_it_is(drive):
    found, sigma = quiet(drive, 0.13 * drive)
    assert sigma == 0.0
    assert found is drive


@pytest.mark.parametrize("step", [1e-4, 0.4])
def test_rounded_numbers_are_not_noise(step):
    drive = np.round(triangle() / step) * step
    assert quiet(drive, 0.13 * drive)[0] is drive


def test_noise_that_the_actuator_follows_is_a_drive():
    recorded, _ = noisy(triangle(), 0.01)
    moved = 0.13 * recorded + 1e-3 * np.random.default_rng(5).standard_normal(recorded.size)
    found, sigma = quiet(recorded, moved)
    assert sigma == 0.0
    assert found is recorded


def test_a_random_walk_is_no_noise():
    rng = np.random.default_rng(8)
    walk = np.clip(37.0 + np.cumsum(rng.standard_normal(8000)), 0.0, 75.0)
    found, sigma = quiet(walk, 0.13 * walk + 2e-3 * rng.standard_normal(walk.size))
    assert sigma == 0.0
    assert found is walk


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 1 << 30), volts=st.floats(0.001, 0.05), hz=st.floats(0.5, 30.0),
    high=st.floats(10.0, 100.0),
)  # fmt: skip
def test_no_drive_comes_out_noisier_than_it_was(seed, volts, hz, high):
    drive = triangle(0.0, high, hz, 1.0)
    recorded, moved = noisy(drive, volts, seed)
    found, _ = quiet(recorded, moved)
    assert np.std(found - drive) <= 1.02 * np.std(recorded - drive)


def test_values_of_a_short_recording_lie_apart_without_any_steps():
    drive = triangle(0.0, 65.0, hz=5.37, seconds=0.6)  # 3,000 samples in 65 V
    recorded, moved = noisy(drive, 0.0015)
    found, sigma = quiet(recorded, moved)
    assert sigma == pytest.approx(0.0015, rel=0.15)
    straight = np.abs(np.convolve(np.diff(drive, 2), np.ones(5), "same")) < 1e-6
    assert np.std((found - drive)[1:-1][straight]) < 0.45 * 0.0015


def test_steps_of_a_digitizer_are_no_noise_in_a_short_recording():
    step_v = 7.5 * 20.0 / 2**14
    drive = step_v * np.round(triangle(0.0, 65.0, hz=5.0, seconds=0.6) / step_v)
    found, sigma = quiet(drive, 0.13 * drive)
    assert sigma == 0.0
    assert found is drive


def test_a_played_drive_of_two_slopes_is_no_noisy_one():
    """A rise at 300 V/s and triangles of 2 Hz, each with steps of its own, of a 16-bit DAC.

    The displacement is all noise, which does not say whether the actuator follows.
    """
    rise = np.linspace(0.0, 75.0, 1251)
    loop = np.concatenate([np.linspace(75.0, 50.0, 1251)[1:], np.linspace(50.0, 75.0, 1251)[1:]])
    played = np.concatenate([rise, np.tile(loop, 4), rise[-2::-1]])
    step_v = 7.5 * 20.0 / (2**16 - 1)
    drive = step_v * np.round(played / step_v)
    moved = np.random.default_rng(1).standard_normal(drive.size)
    found, sigma = quiet(drive, moved)
    assert sigma == 0.0
    assert found is drive
