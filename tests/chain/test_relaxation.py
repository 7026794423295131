"""Compiled relaxations against filters of scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_rig.chain.relaxation import held, off

DRIVE = np.cumsum(np.random.default_rng(0).standard_normal(400))


@pytest.mark.parametrize("tau", [0.05, 0.7, 12.0])
def test_a_lag_behind_samples_that_are_held_is_a_filter_of_first_order(tau):
    decay = np.exp(-1.0 / tau)
    behind = DRIVE[0] + lfilter([0.0, 1.0 - decay], [1.0, -decay], DRIVE - DRIVE[0])
    assert held(DRIVE, tau) == pytest.approx(behind, abs=1e-12)


@pytest.mark.parametrize("tau", [0.05, 0.7, 12.0])
def test_a_lag_behind_straight_lines_is_off_by_a_filter_of_their_steps(tau):
    decay = np.exp(-1.0 / tau)
    behind = lfilter([tau * (1.0 - decay)], [1.0, -decay], np.diff(DRIVE))
    assert off(np.arange(400.0), DRIVE, tau) == pytest.approx(-np.append(0.0, behind), abs=1e-12)
