"""Parameters are as uncertain as all that is possible makes them, not the likeliest alone."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from piezo_rig.diagnosis import over_scales as room
from piezo_rig.diagnosis.over_scales import over_scales

LIKELY, LESS, NEVER = (0.0, 1.0), (0.0, 7.0), (7.0, 7.0)
FOUND = {  # scales -> how far a step goes there, and its covariance
    LIKELY: (np.array([0.0, 0.0]), np.array([[1.0, 0.2], [0.2, 0.5]])),
    LESS: (np.array([3.0, -1.0]), np.array([[4.0, 0.0], [0.0, 2.0]])),
    NEVER: (np.array([1e6, 1e6]), 1e9 * np.eye(2)),
}


@pytest.fixture
def fitted(monkeypatch):
    def grid(columns):
        return {LIKELY: 100.0, LESS: 100.0 + np.log(0.25), NEVER: 80.0}

    forget = SimpleNamespace(forget=lambda: None)
    likelihood = SimpleNamespace(grid=grid, reduced=SimpleNamespace(covariance=forget))
    monkeypatch.setattr(room, "reduce", lambda linear, free: None)
    monkeypatch.setattr(room, "Likelihood", lambda reduced: likelihood)
    monkeypatch.setattr(room, "parameter_step", lambda point, linear, s, held: FOUND[s])
    point = SimpleNamespace(linear=5, sizes=(("a", "x", 1.0), ("a", "y", 1.0)))
    return SimpleNamespace(point=point, linear=None, covariance=FOUND[LIKELY][1])


def test_it_is_the_spread_of_draws_from_the_mixture(fitted):
    rng = np.random.default_rng(1)
    shares = {LIKELY: 0.8, LESS: 0.2}  # 1 to a quarter
    drawn = np.concatenate([
        rng.multivariate_normal(*FOUND[s], size=int(share * 1_000_000))
        for s, share in shares.items()
    ])  # fmt: skip
    expected = drawn.T @ drawn / len(drawn)  # about the fit, not about the mixture's mean
    np.testing.assert_allclose(over_scales(fitted), expected, atol=0.02)


def test_without_parameters_nothing_is_asked(fitted):
    fitted.point.sizes, fitted.covariance = (), np.zeros((0, 0))
    assert over_scales(fitted).shape == (0, 0)
