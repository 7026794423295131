"""A descent's step within physical limits, against a solver for least squares with bounds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from piezo_rig.diagnosis.refit import _bounded


@pytest.mark.parametrize("seed", range(20))
def test_the_others_make_up_for_one_that_is_at_its_limit(seed):
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((30, 4)) @ (np.eye(4) + 0.9 * np.ones((4, 4)))
    y = columns @ np.array([1.0, -0.6, 0.3, 0.8]) + 0.1 * rng.standard_normal(30)
    bounds = np.array([[-np.inf, np.inf], [0.0, 20.0], [-np.inf, np.inf], [-np.inf, np.inf]])
    step = _bounded(columns.T @ columns, columns.T @ y, np.ones(4, bool), bounds)
    best = lsq_linear(columns, y, bounds.T, tol=1e-14)
    assert step == pytest.approx(best.x, abs=1e-6)


def test_those_that_are_held_stay_and_are_not_made_up_for():
    information = np.array([[2.0, 1.0], [1.0, 2.0]])
    free, open_ = np.array([True, False]), np.array([[-np.inf, np.inf]] * 2)
    assert _bounded(information, np.array([4.0, 100.0]), free, open_).tolist() == [2.0, 0.0]
    assert _bounded(information, np.ones(2), np.zeros(2, bool), open_).tolist() == [0.0, 0.0]
