"""Chances of scores, from nulls that are drawn."""

import numpy as np
import pytest
from scipy.stats import chi2

from piezo_rig.diagnosis import scores
from piezo_rig.diagnosis.likelihood import Likelihood
from piezo_rig.diagnosis.reduction import reduce
from tests.diagnosis.columns_at_hand import linear_of

LEVEL = 1e-3


def problem(size: float) -> Likelihood:
    """White noise, and one trial column in which the data lie by so many standard deviations."""
    rng = np.random.default_rng(3)
    columns = rng.standard_normal((9, 60))
    columns[4:7] *= 1e-4  # fine thresholds and dictionary that hardly show
    own = columns[-1] / np.linalg.norm(columns[-1])
    z = rng.standard_normal(60)
    z += (size - own @ z) * own
    return Likelihood(reduce(linear_of(columns, z, bands=4, own=0, fine=2, generic=2)))


def chances(size: float, seeds: int) -> np.ndarray:
    return np.array([
        scores.score(problem(size), [[0]], [0], np.random.default_rng(s), LEVEL).p_value[0]
        for s in range(seeds)
    ])  # fmt: skip


def test_a_chance_close_to_its_level_does_not_hang_on_the_draws(monkeypatch):
    found = chances(3.6, 12)
    assert found.max() < 3.0 * found.min()
    monkeypatch.setattr(scores, "MANY", scores.NULLS)
    few = chances(3.6, 12)
    assert few.max() / few.min() > found.max() / found.min()


@pytest.mark.parametrize("size", [2.5, 3.3, 4.0])
def test_one_column_in_white_noise_has_the_chance_of_its_square(size):
    left = problem(size).reduced
    seen = float((left.trials[:, 0] @ left.z) ** 2 / (left.trials[:, 0] @ left.trials[:, 0]))
    found = np.median(chances(size, 5))
    assert chi2.sf(seen, 1) / 2.5 < found < 2.5 * chi2.sf(seen, 1)
