"""The likelihood over both scales: factors shared along the grid, and the climb over it."""

import numpy as np
import pytest

from piezo_rig.diagnosis.likelihood import GRID, Likelihood, reduce
from piezo_rig.diagnosis.linear import Layout, Linear
from piezo_rig.diagnosis.noise import Spectrum, Whitener

BASE, FINE, GENERIC, TRIALS, SAMPLES = 4, 12, 9, 3, 400


def linear_of(seed: int, fine: float, generic: float) -> tuple[Linear, np.ndarray, np.ndarray]:
    """Random columns, and a residual with so much of the fine and the generic ones in it."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((BASE + FINE + GENERIC + TRIALS, SAMPLES))
    a, b = columns[BASE : BASE + FINE], columns[BASE + FINE : BASE + FINE + GENERIC]
    z = rng.standard_normal(SAMPLES) + 3.0 * columns[-1] * (seed % 2)
    z += fine * rng.standard_normal(FINE) @ a + generic * rng.standard_normal(GENERIC) @ b
    layout = Layout(BASE, 0, FINE, GENERIC, TRIALS)
    residual = np.append(columns @ z, z @ z)
    linear = Linear(layout, (columns @ columns.T)[None], residual[None], np.zeros((1, 5, 5)),
                    np.array([float(SAMPLES)]), np.zeros(GENERIC))  # fmt: skip
    return linear, columns, z


def direct(likelihood: Likelihood, columns: np.ndarray, z: np.ndarray, free: list[int]):
    """Log-likelihood (8, 8) in the space of the samples, the base and ``free`` projected off."""
    r = likelihood.reduced
    q, _ = np.linalg.qr(columns[:BASE].T)
    left = columns - columns @ q @ q.T
    z = z - q @ (q.T @ z)
    fine, generic, trials = np.split(left[BASE:], [FINE, FINE + GENERIC])
    out = np.empty((GRID.size, GRID.size))
    for i, a in enumerate(GRID * r.unit_fine):
        for j, b in enumerate(GRID * r.unit_generic):
            cov = np.eye(SAMPLES) + a * fine.T @ fine + b * generic.T @ generic
            solved = np.linalg.solve(cov, np.vstack([z, trials[free]]).T)
            out[i, j] = -0.5 * (z @ solved[:, 0] + np.linalg.slogdet(cov)[1])
            if free:
                gram, along = trials[free] @ solved[:, 1:], trials[free] @ solved[:, 0]
                out[i, j] += 0.5 * along @ np.linalg.solve(gram, along)
    return out


@pytest.mark.parametrize(("seed", "fine", "generic"), [
    (0, 0.0, 0.0), (1, 0.3, 0.0), (2, 0.0, 0.3), (3, 0.1, 0.02), (4, 1.0, 1.0), (5, 0.02, 0.1),
])  # fmt: skip
@pytest.mark.parametrize("free", [[], [2], [0, 2]])
def test_the_climb_finds_the_largest_likelihood_of_the_whole_grid(seed, fine, generic, free):
    linear, columns, z = linear_of(seed, fine, generic)
    likelihood = Likelihood(reduce(linear))
    whole = direct(likelihood, columns, z, free)
    assert likelihood.evidence(free) == pytest.approx(whole.max(), rel=1e-9)
    i, j = np.unravel_index(int(whole.argmax()), whole.shape)
    units = likelihood.reduced.unit_fine, likelihood.reduced.unit_generic
    assert likelihood.best_scales(free) == pytest.approx((GRID[i] * units[0], GRID[j] * units[1]))


def test_a_column_that_repeats_another_adds_nothing():
    linear, _, _ = linear_of(1, 0.1, 0.1)
    gram = linear.white[0]
    gram[-2], gram[:, -2] = gram[-1], gram[:, -1].copy()
    gram[-2, -2] = gram[-1, -1]
    linear.residual[0, -3] = linear.residual[0, -2]
    likelihood = Likelihood(reduce(linear))
    assert likelihood.evidence([1, 2]) == pytest.approx(likelihood.evidence([2]), rel=1e-9)


def test_another_residual_of_the_same_columns_is_reduced_as_if_alone():
    first, _, _ = linear_of(1, 0.3, 0.0)
    reduce(first)
    z = np.random.default_rng(7).standard_normal(SAMPLES)
    _, columns, _ = linear_of(1, 0.3, 0.0)
    residual = np.append(columns @ z, z @ z)[None]
    shared = reduce(Linear(first.layout, first.white, residual, first.raw, first.count, first.law,
                           axes=first.axes))  # fmt: skip
    alone = reduce(Linear(first.layout, first.white, residual, first.raw, first.count, first.law))
    assert np.linalg.norm(shared.z) == pytest.approx(np.linalg.norm(alone.z))
    assert shared.extra == pytest.approx(alone.extra)
    assert Likelihood(shared).evidence() == pytest.approx(Likelihood(alone).evidence())


def test_noise_that_is_even_is_whitened_by_a_factor():
    power = 4e-6
    flat = Whitener(Spectrum(np.array([1e-3, 0.5]), np.log([power, power]), np.zeros(2)))
    rows = np.random.default_rng(0).standard_normal((3, 50))
    assert flat(rows) == pytest.approx(rows / np.sqrt(power))


def test_rows_are_filtered_as_each_by_itself():
    red = Whitener(Spectrum(np.array([1e-3, 0.5]), np.log([1.0, 0.1]), np.zeros(2)))
    rows = np.random.default_rng(0).standard_normal((19, 64))
    assert red(rows) == pytest.approx(np.array([red(row) for row in rows]))
