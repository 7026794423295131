"""Recordings shortened to averages of cells and single samples: what is kept, and its noise."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import toeplitz

from piezo_rig.chain import half_loops
from piezo_rig.diagnosis.cells import Cells, beside_corners, cells_of, corners
from piezo_rig.diagnosis.groups import Group, Groups
from piezo_rig.diagnosis.noise import Spectrum
from piezo_rig.diagnosis.whitening import CellWhitener

RATE = 5000.0


def triangles(cycles):
    up = np.linspace(0.0, 60.0, 1251)
    return np.append(np.tile(np.concatenate([up[:-1], up[:0:-1]]), cycles), 0.0)


@settings(max_examples=50, deadline=None)
@given(
    st.integers(2, 9), st.lists(st.booleans(), min_size=1, max_size=40), st.integers(0, 2**32 - 1)
)
def test_cells_hold_averages_and_samples_in_order(factor, marks, seed):
    values = np.random.default_rng(seed).normal(size=len(marks) * factor + factor - 1)
    cells = Cells(factor, np.array(marks).tobytes())
    want = []
    for k, split in enumerate(marks):
        cut = values[k * factor : (k + 1) * factor]
        want += list(cut) if split else [cut.mean()]
    short = cells.shortened(values)
    assert np.allclose(short, want)
    assert cells.size == len(want)
    whole = values[: len(marks) * factor].reshape(-1, factor).mean(axis=1)
    assert np.allclose(cells.averages(short[None])[0], whole)
    assert cells.share.sum() == pytest.approx(len(marks))
    assert cells.centred(short[None]).shape == (1, cells.size)


def test_corners_of_triangles_and_holds_are_found_and_slow_sines_have_none():
    drive = triangles(2)
    found = corners(drive, ((0, drive.size),), 7)
    for turn in (0, 1250, 2500, 3750):
        assert min(abs(k - turn) for k in found) <= 7
    assert all(min(abs(k - t) for t in (0, 1250, 2500, 3750, 5000)) <= 14 for k in found)
    held = np.concatenate([np.linspace(0, 50, 1000), np.full(2000, 50.0)])
    noisy = held + np.random.default_rng(1).normal(0, 0.002, held.size)
    found = corners(noisy, ((0, noisy.size),), 7)
    assert min(abs(k - 1000) for k in found) <= 7
    assert all(min(abs(k - 1000), k) <= 14 for k in found)
    sine = 30.0 - 30.0 * np.cos(2 * np.pi * 2.0 * np.arange(10_000) / RATE)
    found = corners(sine, ((0, sine.size),), 7)
    assert all(k < 50 or k > 9_950 for k in found)


def test_samples_are_kept_from_before_a_corner_until_a_mode_has_rung_off():
    at = [1250, 1254, 2500, 3750]
    assert beside_corners(at, RATE, 60, 4000) == ((1230, 1370), (2480, 2620), (3730, 3870))
    few = beside_corners(range(1000, 90_000, 1000), RATE, 3, 90_000)
    assert len(few) == 3
    cells = cells_of(0, 4000, beside_corners(at, RATE, 60, 4000), 7)
    assert cells.split.sum() * 7 >= 3 * 140
    assert cells.split.sum() * 7 <= 3 * (140 + 14)


def test_stretches_of_single_samples_stay_short_at_any_rate_and_speed():
    """A covariance is made of each whole: at 50 kSa/s a corner every 25 ms was one of gigabytes."""
    for rate, apart in ((50_000.0, 1250), (5000.0, 125), (50_000.0, 25_000)):
        n = 40 * apart
        found = beside_corners(range(apart, n, apart), rate, 30, n, 5000)
        assert found
        assert all(b - a <= 1000 for a, b in found)
        assert sum(b - a for a, b in found) <= 5000
        assert all(a < b <= c for (a, b), (c, _) in pairwise(found))


@pytest.mark.parametrize("corner", [None, 0.002, 0.2])
def test_noise_is_white_in_cells_and_beside_corners(corner):
    """Against the exact covariance of a noise whose spectrum the whitener is told."""
    factor, count = 5, 60
    split = np.zeros(count, bool)
    split[10:16] = split[40:47] = True
    cells = Cells(factor, split.tobytes())
    n = count * factor
    f = np.geomspace(1e-5, 0.5, 400)
    power = np.ones(f.size) if corner is None else 1.0 / (1.0 + (f / corner) ** 2) + 0.02
    grid = np.arange(1 << 17) / (1 << 18)
    exact = np.interp(grid, f, power)
    r = np.fft.irfft(np.append(exact, exact[-1]))[:n]
    samples = Spectrum(f, np.log(power), np.zeros(f.size))
    average = np.kron(np.eye(count), np.full((1, factor), 1.0 / factor))
    of_cells = average @ toeplitz(r) @ average.T
    # the spectrum of the averages: that of the samples seen through the average, folded
    g = np.geomspace(1e-4, 0.5, 300)
    folded = np.zeros(g.size)
    for k in range(factor):
        x = (g + k) / factor
        x = np.minimum(x, 1.0 - x)
        window = (np.sin(np.pi * (g + k)) / (factor * np.sin(np.pi * (g + k) / factor))) ** 2
        folded += window * np.interp(x, f, power) / factor
    averages = Spectrum(g, np.log(folded), np.zeros(g.size))
    # that it is the right one
    assert np.allclose(of_cells[30, 30], 2 * np.trapezoid(folded, g), rtol=0.05)
    whitener = CellWhitener(averages, samples, raised=0.0)
    turned = whitener(cells.shortened(np.eye(n)), cells)  # how each sample shows
    covariance = turned.T @ toeplitz(r) @ turned
    inside = np.r_[10:count, count : cells.size]  # where the causal filter has settled
    off = covariance[np.ix_(inside, inside)] - np.eye(inside.size)
    assert np.abs(np.diag(off)).max() < 0.1
    assert np.linalg.norm(off, 2) < 0.3


def plays(drive):
    """A Prandtl-Ishlinskii body, sample by sample."""
    thresholds, weights = np.array([2.0, 6.0, 14.0, 25.0]), np.array([0.03, 0.02, 0.02, 0.01])
    out, state = np.empty(drive.size), np.zeros(4)
    for i, v in enumerate(drive):
        state = np.clip(state, v - thresholds, v + thresholds)
        out[i] = 0.06 * v + weights @ state
    return out


@pytest.mark.parametrize("block", [(0, 5001), (700, 4900)])
def test_a_thinned_drive_shows_what_a_small_change_does(block):
    """Its corners, and what came before the block, are kept: as if played whole, then thinned."""
    drive = triangles(2)
    group = Group(
        np.arange(drive.size) / RATE, drive, np.zeros((1, drive.size)), np.zeros(1), "virgin",
        (block,), half_loops(drive), "0-60", ((0,),),
        fine=beside_corners([0, 1250, 2500, 3750], RATE, 60, drive.size),
    )  # fmt: skip
    groups = Groups((group,), RATE, 7)
    short, inside = groups.short(group)
    assert short.drive_v.size < 0.4 * drive.size
    whole = plays(1.01 * drive) - plays(drive)
    there = (plays(1.01 * short.drive_v) - plays(short.drive_v))[inside]
    off = there - groups.thinned(group, whole)
    assert np.sqrt(np.mean(off**2)) < 1e-3 * np.ptp(whole)
    assert np.abs(off).max() < 0.02 * np.ptp(whole)  # in cells in which a slider gives way
    seconds = groups.thinned(group, group.time_s)
    assert np.array_equal(short.time_s[inside], seconds)
