"""Turning points, clean and noisy."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from small_models import ride

from piezo_rig.chain import dead_band, half_loops

TURNS = [0.0, 75.0, 70.0, 75.0, 70.0, 75.0, 40.0, 75.0, 0.0]


def test_each_small_loop_has_its_own_range():
    loops = half_loops(ride(TURNS, 250))
    assert loops.extremum_v == pytest.approx(TURNS[:-1])
    assert loops.range_v == pytest.approx([75, 75, 5, 5, 5, 5, 35, 35])
    assert list(loops.direction) == [1, -1, 1, -1, 1, -1, 1, -1]


def test_noise_on_the_drive_makes_no_half_loops():
    rng = np.random.default_rng(1)
    clean = ride(TURNS, 1250)
    loops = half_loops(clean + 0.002 * rng.standard_normal(clean.size))
    assert len(loops) == len(TURNS) - 1
    assert loops.range_v == pytest.approx([75, 75, 5, 5, 5, 5, 35, 35], abs=0.02)
    assert 0.01 < dead_band(clean + 0.002 * rng.standard_normal(clean.size)) < 0.04


@pytest.mark.parametrize("seed", range(5))
def test_a_random_walk_is_no_noise(seed):
    walk = np.cumsum(0.3 * np.random.default_rng(seed).standard_normal(6000))
    assert dead_band(walk) == 0.0
    assert dead_band(3.0 * walk) == 0.0


def test_small_loops_are_counted_beside_large_ones_in_noise():
    """A decay from 40 V to 0.1 V, in noise of 2 mV."""
    t = np.arange(20_000) / 1e3
    decay = 40.0 * np.exp(-0.3 * t) * np.sin(2.0 * np.pi * t)
    noisy = decay + 0.002 * np.random.default_rng(1).standard_normal(t.size)
    assert 0.01 < dead_band(noisy) < 0.04
    assert len(half_loops(noisy)) == 41


@pytest.mark.parametrize("per_cycle", [7, 20, 500])
def test_a_clean_sine_has_no_dead_band(per_cycle):
    sine = np.sin(2 * np.pi * np.arange(4000) / per_cycle)
    assert dead_band(sine) < 1e-9
    turns = 2 * 4000 / per_cycle
    assert abs(len(half_loops(sine)) - turns) <= 2


def test_ringing_of_ten_millivolts_does_not_cut_a_rise_in_two():
    loops = half_loops(ride([0.0, 20.0, 19.99, 20.01, 20.0, 40.0, 0.0], 50))
    assert loops.range_v == pytest.approx([40, 40])
    assert loops.extremum_v == pytest.approx([0, 40])
    assert len(half_loops(ride([0.0, 20.0, 19.9, 40.0, 0.0], 50))) == 4  # that is a reversal


def test_a_hold_between_ramps_is_not_a_turning_point():
    drive = np.concatenate([np.linspace(0, 5, 50), np.full(30, 5.0), np.linspace(5, 9, 50)])
    assert len(half_loops(drive)) == 1


def test_a_hold_at_the_top_is_one_turning_point():
    drive = np.concatenate([np.linspace(0, 5, 50), np.full(30, 5.0), np.linspace(5, 0, 50)])
    loops = half_loops(drive)
    assert len(loops) == 2
    assert loops.extremum_v[1] == 5.0


def test_sixteen_samples_of_a_waveform_say_nothing_of_noise():
    corners = [0.0, 0.0, 45.0, 0.0, 1.0, 0.0]
    drive = np.concatenate([[0.0], *(np.linspace(a, b, 4)[1:] for a, b in pairwise(corners))])
    assert drive.size == 16
    assert dead_band(drive) == 0.0
    assert len(half_loops(drive)) == 4  # the one of 1 V too
