"""A recording of unknown history begins with a first rise only where its first cycle says so."""

from __future__ import annotations

import numpy as np
import pytest
from recordings import sweep
from small_models import ride

from piezo_rig.identification.data import gathered, prepare

RADII, WEIGHTS = np.linspace(2.0, 45.0, 12), np.full(12, 0.004)
N = 200  # samples of a cycle
STEADY = slice(2 * N, None)


def played(drive):
    """Play operators, sample by sample, from an empty memory."""
    state, out = np.zeros(RADII.size), []
    for v in drive:
        state = np.clip(state, v - RADII, v + RADII)
        out.append(0.08 * v + WEIGHTS @ state)
    return np.array(out)


def wave(shape, cycles=6, samples=N):
    return shape(np.arange(cycles * samples + 1) / samples)


def bipolar(phase):
    return 100.0 * np.sin(2 * np.pi * phase)


def unipolar(phase):
    return 50.0 * (1.0 - np.cos(2 * np.pi * phase))


def growing(phase):
    return 16.0 * phase * np.sin(2 * np.pi * phase)


def begins_at_rest(drive, y, history="unknown"):
    (track,) = prepare([sweep(drive, y, history=history)], first_rises=True).tracks
    return track.virgin


@pytest.mark.parametrize("shape", [bipolar, unipolar, growing])
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_a_first_rise_from_rest_is_recognised(shape, noise):
    drive = wave(shape)
    y = played(drive) + noise * np.random.default_rng(1).standard_normal(drive.size)
    assert begins_at_rest(drive, y)


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("drift", [0.0, 1e-3])
@pytest.mark.parametrize("shape", [bipolar, unipolar])
def test_a_settled_loop_that_was_cut_at_0_v_is_not(shape, noise, drift):
    drive = wave(shape)
    y = played(drive) + noise * np.random.default_rng(1).standard_normal(drive.size)
    y = y + drift * np.arange(drive.size)
    assert not begins_at_rest(drive[STEADY], y[STEADY])


def test_nor_is_one_that_begins_at_its_lowest_drive():
    drive = wave(bipolar)
    cut = slice(int(1.75 * N), None)
    assert drive[cut][0] == drive.min() == -100.0
    assert not begins_at_rest(drive[cut], played(drive)[cut])


def test_a_sweep_that_only_comes_back_to_0_v_at_its_end_shows_what_is_left_there():
    drive = ride([0.0, 75.0, 35.0, 75.0, 35.0, 75.0, 0.0], 100)
    y = played(np.concatenate([drive, drive]))
    assert begins_at_rest(drive, y[: drive.size])
    assert not begins_at_rest(drive, y[drive.size :])


@pytest.mark.parametrize("seed", range(8))
def test_turning_points_of_a_random_drive_say_nothing_of_a_drift(seed):
    """Two of them may be at one drive, on branches that are apart."""
    amid = np.random.default_rng(seed).uniform(14.0, 60.0, 60)
    drive = ride([0.0, *amid, 75.0, 0.0], 40)
    whole = ride([0.0, 75.0, 0.0], 100)
    remembered = played(np.concatenate([whole, drive]))[whole.size :]
    assert begins_at_rest(drive, played(drive))
    assert not begins_at_rest(drive, remembered)


@pytest.mark.parametrize("bias", [0.0, 40.0])
def test_a_growing_wave_begins_at_rest_at_0_v_and_not_amid_its_drive(bias):
    """To get to 40 V it was moved, and it remembers that it rose."""
    n = 30 * N
    cycles = np.arange(n + 1) / N
    wave = bias + 1.2 * cycles * np.sin(2 * np.pi * cycles)
    up = np.linspace(0.0, bias, 100)[:-1]
    y = played(np.concatenate([up, wave]))[up.size :]
    assert begins_at_rest(wave, y) is (bias == 0.0)


def test_what_the_user_says_holds():
    drive = wave(unipolar)
    y = played(drive)
    assert begins_at_rest(drive[STEADY], y[STEADY], history="virgin")
    data = prepare([sweep(drive, y), sweep(drive, y, history="carried")], first_rises=True)
    assert [t.sweeps for t in data.tracks] == [(0, 1)]


def test_data_say_how_far_they_know_the_curves():
    drive = ride([0.0, 75.0, 60.0, 75.0, 60.0], 100)
    virgin = prepare([sweep(drive, played(drive))])
    assert virgin.known_v(one_curve=False) == {"first_rise": 75.0, "branch": 15.0}
    assert virgin.known_v(one_curve=True) == {"first_rise": 75.0, "branch": 150.0}
    drive = wave(unipolar)
    unknown = prepare([sweep(drive[STEADY], played(drive)[STEADY], history="unknown")])
    assert unknown.known_v(one_curve=True) == pytest.approx({"first_rise": 50.0, "branch": 100.0})


@pytest.mark.parametrize(("count", "lines"), [(3, 3), (18, 1)])
def test_what_many_recordings_begin_with_is_said_once(count, lines):
    what = "history unknown, but it begins at rest (so it is said): taken for an initiation curve"
    notes = [f"0-15 test {k}.lvm: sweep_{k:04d}: {what}" for k in range(1, count + 1)]
    said = gathered([*notes[:1], "something else", *notes[1:]])
    assert "something else" in said
    assert len(said) == lines + 1
    if lines == 1:
        assert said[0] == f"0-15 test 1.lvm: sweep_0001 and 17 more: {what}"
