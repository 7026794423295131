"""The likelihood over both scales: factors shared along the grid, and the climb over it."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_rig.diagnosis import reduction
from piezo_rig.diagnosis.likelihood import GRID, Likelihood
from piezo_rig.diagnosis.linear import Linear
from piezo_rig.diagnosis.noise import Spectrum, Whitener
from piezo_rig.diagnosis.reduction import covariance_of, reduce
from tests.diagnosis.columns_at_hand import linear_of
from tests.more import first_of

BANDS, OWN, FINE, GENERIC, TRIALS, SAMPLES = 3, 1, 12, 9, 3, 400
SHARED = BANDS + FINE + GENERIC


def problem(seed: int, fine: float, generic: float) -> tuple[Linear, np.ndarray, np.ndarray]:
    """Random columns, and a residual with so much of the fine and the generic ones in it."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((SHARED + OWN + TRIALS, SAMPLES))
    a, b = columns[BANDS : BANDS + FINE], columns[BANDS + FINE : SHARED]
    z = rng.standard_normal(SAMPLES) + 3.0 * columns[-1] * (seed % 2)
    z += fine * rng.standard_normal(FINE) @ a + generic * rng.standard_normal(GENERIC) @ b
    return linear_of(columns, z, BANDS, OWN, FINE, GENERIC), columns, z


def direct(likelihood: Likelihood, columns: np.ndarray, z: np.ndarray, free: list[int]):
    """Log-likelihood (8, 8) in the space of the samples, the base and ``free`` projected off."""
    r = likelihood.reduced
    base = columns[[*range(BANDS), *range(SHARED, SHARED + OWN)]]
    q, _ = np.linalg.qr(base.T)
    left = columns - columns @ q @ q.T
    z = z - q @ (q.T @ z)
    fine, generic = left[BANDS : BANDS + FINE], left[BANDS + FINE : SHARED]
    trials = left[SHARED + OWN :]
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
@pytest.mark.parametrize("free", first_of(1, [[0, 2], [2], []]))
def test_the_climb_finds_the_largest_likelihood_of_the_whole_grid(seed, fine, generic, free):
    linear, columns, z = problem(seed, fine, generic)
    likelihood = Likelihood(reduce(linear))
    whole = direct(likelihood, columns, z, free)
    assert likelihood.evidence(free) == pytest.approx(whole.max(), rel=1e-9)
    i, j = np.unravel_index(int(whole.argmax()), whole.shape)
    units = likelihood.reduced.unit_fine, likelihood.reduced.unit_generic
    assert likelihood.best_scales(free) == pytest.approx((GRID[i] * units[0], GRID[j] * units[1]))


def test_a_trial_as_it_is_is_taken_off_the_data_and_the_scales_are_profiled_anew():
    linear, columns, z = problem(3, 0.1, 0.02)
    likelihood = Likelihood(reduce(linear))
    less = [direct(likelihood, columns, z - t, []).max() for t in columns[SHARED + OWN :]]
    assert np.argmax(less) == TRIALS - 1  # the one that was put in
    assert likelihood.evidence_less_each() == pytest.approx(less, rel=1e-9)


@pytest.mark.parametrize("free", [[], [3], [1], [1, 3]])
def test_what_is_handed_on_is_not_projected_off_and_the_rest_is(free):
    """Base columns by number, bands before others; distances as in the space of the samples."""
    linear, columns, z = problem(3, 0.1, 0.02)
    place = {i: i if i < BANDS else SHARED + i - BANDS for i in range(BANDS + OWN)}
    off = columns[[p for i, p in place.items() if i not in free]]
    q, _ = np.linalg.qr(off.T)
    left = np.vstack([columns[SHARED + OWN :], columns[[place[i] for i in free]]])
    left, z = left - left @ q @ q.T, z - q @ (q.T @ z)
    found = reduce(linear, free=free)
    assert found.trials.T @ found.trials == pytest.approx(left @ left.T, abs=1e-8)
    assert found.trials.T @ found.z == pytest.approx(left @ z, abs=1e-8)
    assert found.z @ found.z + found.extra == pytest.approx(z @ z)
    fine = columns[BANDS : BANDS + FINE]
    fine = fine - fine @ q @ q.T
    covariance = np.eye(SAMPLES) + 0.3 * fine.T @ fine
    expected = left @ np.linalg.solve(covariance, z)
    solved = np.linalg.solve(covariance_of(found, (0.3, 0.0)), found.z)
    assert found.trials.T @ solved == pytest.approx(expected, rel=1e-8, abs=1e-8)


def test_points_of_one_frame_share_the_covariance_of_what_they_hand_on_alike():
    first, columns, z = problem(1, 0.1, 0.1)
    other = linear_of(columns + np.eye(len(columns), SAMPLES, SHARED), z, BANDS, OWN, FINE, GENERIC)
    other = replace(other, frame=first.frame)
    assert reduce(first, free=[BANDS]).covariance is reduce(other, free=[BANDS]).covariance
    assert reduce(first).covariance is not reduce(other).covariance


def test_a_column_that_repeats_another_adds_nothing():
    _, columns, z = problem(1, 0.1, 0.1)
    columns[-2] = columns[-1]
    likelihood = Likelihood(reduce(linear_of(columns, z, BANDS, OWN, FINE, GENERIC)))
    assert likelihood.evidence([1, 2]) == pytest.approx(likelihood.evidence([2]), rel=1e-9)


def test_another_residual_of_the_same_columns_is_reduced_as_if_alone():
    first, columns, _ = problem(1, 0.3, 0.0)
    reduce(first)
    z = np.random.default_rng(7).standard_normal(SAMPLES)
    other = linear_of(columns, z, BANDS, OWN, FINE, GENERIC)
    shared, alone = reduce(replace(first, residual=other.residual)), reduce(other)
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


@pytest.mark.parametrize("seed", range(5))
def test_what_rounding_leaves_of_columns_inside_the_base_is_no_direction(seed):
    """Neighbours differ little, as bands and fine thresholds do, down to what rounding hides."""
    rng = np.random.default_rng(seed)
    bands, own = 1e3 * rng.standard_normal((2, 15, SAMPLES))
    bands = np.vstack([bands, bands + np.geomspace(1e-2, 4e-5, 15)[:, None] * own])
    fine = bands[:15] + bands[15:]
    fine += np.geomspace(1e-1, 1e-7, 15)[:, None] * 1e3 * rng.standard_normal(fine.shape)
    frame = linear_of(np.vstack([bands, fine]), own[0], len(bands), 0, len(fine), 0).frame
    shared = reduction.reduced_frame(frame)
    off = shared.off @ bands
    basis = shared.axes @ (fine - shared.cross.T @ off)
    assert len(off) == len(bands)
    assert len(basis) > 4
    np.testing.assert_allclose(basis @ basis.T, np.eye(len(basis)), atol=1e-3)
    np.testing.assert_allclose(basis @ off.T, 0.0, atol=1e-3)
