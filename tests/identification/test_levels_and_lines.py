"""Drives that repeat few levels, growing amplitudes, few samples."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from recordings import sweep

from piezo_rig.identification import identify
from piezo_rig.identification.solve import condition_number, solve_smooth, untold

RADII = np.array([0.0, 4.1, 11.3, 19.7, 30.2, 44.9, 61.7])
WEIGHTS = np.array([0.1, 0.021, 0.014, 0.027, 0.011, 0.019, 0.024])


def plays(drive, radii=RADII, weights=WEIGHTS):
    """Play operators, sample by sample, from rest."""
    state, out = np.zeros(radii.size), np.empty(drive.size)
    for i, v in enumerate(drive - drive[0]):
        state = np.clip(state, v - radii, v + radii)
        out[i] = weights @ state
    return out


def sine(hz, rate=10_000.0, seconds=0.4, phase=0.0):
    t = np.arange(int(rate * seconds)) / rate
    return 100.0 * np.sin(2 * np.pi * hz * t + phase)


def steady(hz, noise=0.0, phase=0.4):
    """A recording in the midst of a sine that has gone on for long."""
    drive = sine(hz, phase=phase)
    y = plays(np.concatenate([sine(hz, seconds=0.1), drive]))[-drive.size :]
    y = y + noise * np.random.default_rng(2).standard_normal(y.size)
    return sweep(drive, y, history="unknown")


def elsewhere(model):
    """Largest error on another drive, share of the travel."""
    t = np.arange(4000) / 1e4
    drive = 80 * np.sin(2 * np.pi * 33 * t) + 20 * np.sin(2 * np.pi * 71 * t)
    y = plays(drive)
    return np.max(np.abs(model.simulate(t, drive) - y)) / np.ptp(y)


@pytest.mark.parametrize("hz", [50, 100])
def test_a_sine_that_repeats_its_levels_is_no_worse_elsewhere_than_it_says(hz):
    found = identify([steady(hz, noise=0.005)], "classical")
    assert elsewhere(found.model) < 1.5e-3
    assert found.bands.condition_number < 1e8
    assert any("repeats the same" in note for note in found.left_out)
    drive = 2.0 * found.bands.drive_v
    branch = np.maximum(drive[:, None] - 2.0 * RADII, 0.0) @ WEIGHTS
    low, high = found.bands.later_um.T
    assert np.mean((low <= branch) & (branch <= high)) > 0.9


def test_a_sine_whose_levels_move_on_needs_no_warning():
    found = identify([steady(47.3, noise=0.005)], "classical")
    assert not any("repeats the same" in note for note in found.left_out)


def test_more_elements_than_levels_go_on_as_their_neighbours():
    found = identify([steady(100, noise=0.005)], "classical", elements=80)
    assert any("cannot tell" in note for note in found.left_out)
    assert elsewhere(found.model) < 0.01
    assert found.bands.condition_number < 1e15
    drive = 2.0 * found.bands.drive_v
    branch = np.maximum(drive[:, None] - 2.0 * RADII, 0.0) @ WEIGHTS
    low, high = found.bands.later_um.T
    assert np.mean((low <= branch) & (branch <= high)) > 0.9


def test_bands_that_the_data_do_not_see_are_put_between_their_neighbours():
    design = np.array([[1.0, 0, 0, 0], [0, 1, 1, 0], [0, 0, 0, 1]])
    gram = design.T @ design
    assert untold(gram).shape == (4, 1)
    found = solve_smooth(gram, design.T @ [1.0, 5.0, 4.0], np.ones(4, bool), 0.0, ((0, 4),))
    assert found == pytest.approx([1, 2, 3, 4])
    assert 1e12 < condition_number(gram) < 1e16


GROW = np.minimum(np.arange(4000) / 3000, 1.0)


@pytest.mark.parametrize(
    "drive",
    [
        GROW * sine(50),
        GROW * sine(83.3),
        sine(20, 2000),
        50.0 - 50.0 * np.cos(2 * np.pi * 37 * np.arange(3000) / 1e4),
    ],
    ids=["growing", "growing at an odd rate", "sparse", "unipolar"],
)
def test_break_points_are_read_off_all_half_loops(drive):
    found = identify([sweep(drive, plays(drive))], "classical")
    assert found.fitted.max_percent < 1e-7
    springs = 1.0 / np.cumsum(WEIGHTS)
    springs = np.append(-np.diff(springs), springs[-1])
    table = found.model.maxwell.elements
    assert table.k_v_per_um == pytest.approx(springs, abs=1e-6)
    assert elsewhere(found.model) < 1e-9


def test_minor_loops_tell_what_the_longest_half_loop_does_not():
    random = np.random.default_rng(4).uniform(-99, 99, 60)
    turns = np.concatenate([[0.0, 100.0, -100.0], random])
    drive = np.concatenate([np.linspace(a, b, 40, endpoint=False) for a, b in pairwise(turns)])
    found = identify([sweep(drive, plays(drive))], "classical")
    assert found.fitted.max_percent < 1e-7
    assert elsewhere(found.model) < 1e-9


def test_two_break_points_between_two_samples_are_said_and_in_the_bands():
    radii = np.array([0.0, 20.0, 48.0, 50.0, 70.0])  # a sine of 50 levels steps over 48 and 50
    weights = np.array([0.1, 0.02, 0.03, 0.02, 0.02])
    drive = sine(100, phase=0.5 * np.pi)
    y = plays(np.concatenate([sine(100, seconds=0.0025), drive]), radii, weights)[-drive.size :]
    found = identify([sweep(drive, y, history="unknown")], "classical")
    assert found.fitted.max_percent < 1e-7
    assert any("between samples" in note for note in found.left_out)
    at = 2.0 * found.bands.drive_v
    branch = np.maximum(at[:, None] - 2.0 * radii, 0.0) @ weights
    low, high = found.bands.later_um.T
    assert np.mean((low - 1e-9 <= branch) & (branch <= high + 1e-9)) > 0.9


@pytest.mark.parametrize("digits", [9, 6, 4])
def test_rounded_displacements_are_not_cut_to_pieces(digits):
    drive = sine(20)
    found = identify([sweep(drive, np.round(plays(drive), digits))], "classical")
    assert len(found.model.maxwell.elements) < 12
    assert elsewhere(found.model) < 10.0**-digits


def test_relays_that_few_levels_step_over_leave_finite_bands():
    from strangers import preisach

    drive = sine(100, seconds=0.2)
    y = preisach(None, drive)
    found = identify([sweep(drive, y, history="unknown")], "classical")
    assert np.all(np.isfinite(found.bands.later_um))
    assert np.max(np.ptp(found.bands.later_um, axis=1)) < 0.2 * np.ptp(y)
    assert found.bands.condition_number < 1e15
