"""Compliances are never negative: the best such ones, and where that leads a model bent far."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from piezo_rig.chain.bend import Bend
from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.compliances import solved
from piezo_rig.run_file.sweep import Sweep


@given(
    st.integers(1, 8), st.integers(0, 3), st.integers(0, 2**32 - 1), st.floats(0.0, 2.0),
)  # fmt: skip
def test_bounded_unknowns_leave_as_little_as_an_independent_solver_makes_them(
    bounded, others, seed, room
):
    rng = np.random.default_rng(seed)
    n = bounded + others
    columns = rng.standard_normal((40, n)) * 10.0 ** rng.uniform(-2.0, 2.0, n)
    target = columns @ rng.standard_normal(n) + rng.standard_normal(40)
    least = -room * rng.random(bounded)
    found = solved(columns.T @ columns, columns.T @ target, least)
    lower = np.concatenate([least, np.full(others, -np.inf)])
    best = lsq_linear(columns, target, (lower, np.inf), method="bvls", tol=1e-14).x
    assert np.all(found[:bounded] >= least - 1e-12)
    left, least_left = (float(np.sum((columns @ x - target) ** 2)) for x in (found, best))
    assert left <= least_left * (1.0 + 1e-9) + 1e-12


@given(st.lists(st.floats(-3.0, 3.0), min_size=4, max_size=4))
def test_the_curvature_of_a_bend_is_the_second_derivative_of_what_it_adds(terms):
    bend = Bend.of(None, from_v=0.0, over_v=1.0,
                   **dict(zip(("square", "cube", "fourth", "fifth"), terms, strict=True)))
    u = np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])
    step = 1e-4
    low, middle, high = (bend._bent(u + d) for d in (-step, 0.0, step))
    by_differences = (low - 2.0 * middle + high) / step**2
    assert np.allclose(Bend.curvature() @ np.array(terms), by_differences, atol=1e-4)


def bent_far(seed: int = 1) -> Sweep:
    """One slow sine of an actuator whose displacement bends by a sixth of its travel."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 13.0, 0.005)
    drive = 1.8 - 1.8 * np.cos(2.0 * np.pi * time)
    moved = np.zeros_like(drive)
    for width in np.linspace(0.0, 1.8, 40):
        at = 0.0
        for i, v in enumerate(drive):
            at = min(max(at, v - width), v + width)
            moved[i] += np.exp(-width / 0.7) * at
    moved *= 15.0 / np.ptp(moved)
    moved += 2.5 * np.sin(np.pi * moved / 15.0)
    relaxing = np.zeros_like(moved)
    for i in range(1, moved.size):
        relaxing[i] = relaxing[i - 1] * np.exp(-0.005 / 0.8) + moved[i] - moved[i - 1]
    moved += 0.03 * relaxing + 0.03 * rng.standard_normal(moved.size)
    kept = time >= 1.0
    return Sweep("sweep_0001", drive[kept], moved[kept], 200.0, 1.0, 0.0, 1.0, 1, 0.0, "", 1,
                 "unknown", 0.0, "IMPORTED")  # fmt: skip


@pytest.mark.study
def test_a_displacement_that_bends_far_is_followed_down_to_the_noise():
    found = diagnose([bent_far()])
    rms = [rung.rms_nm for rung in found.rungs]
    assert rms == sorted(rms, reverse=True)
    assert rms[0] > 500.0
    assert rms[-1] < 36.0  # noise of 30 nm
    assert not found.unexplained.detected
