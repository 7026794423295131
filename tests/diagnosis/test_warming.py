"""A zero that settles over the session is no noise, though repeats differ by it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_rig.causes import named_model
from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.fit import starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.warming import drifting, without_settling
from piezo_rig.identification import prepare
from piezo_rig.run_file.sweep import Sweep
from tests.diagnosis.sliders import play
from tests.diagnosis.small_bench import recordings
from tests.more import first_of

RATE, NOISE_NM = 1000.0, 3.0
EVERY_S, SETTLES_S = 60.0, 400.0
TOPS = (75.0, 30.0, 50.0, 62.0, 40.0)
LIMITS = np.sort(np.random.default_rng(3).uniform(0.5, 34.0, 30))


def slow(rng: np.random.Generator, n: int) -> np.ndarray:
    """Noise of 3 nm whose low frequencies are the loudest: three relaxations, a decade apart."""
    parts = []
    for tau_s in (0.02, 0.2, 2.0):
        keep = np.exp(-1.0 / RATE / tau_s)
        drive = rng.standard_normal(n + 8000)
        parts.append(lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], drive)[8000:])
    return 1e-3 * NOISE_NM * np.sum(parts, axis=0) / np.sqrt(3.0)


def session(seed: int, nm_per_s: float) -> list[Sweep]:
    """Five drives, twice each, while the zero moves by that much less and less."""
    rng, out = np.random.default_rng(seed), []
    order = rng.permutation(len(TOPS))
    for number in range(2 * len(TOPS)):
        top = TOPS[order[number % len(TOPS)]]
        time = np.arange(2000) / RATE
        volts = top * (1.0 - np.abs(2.0 * ((2.0 * time) % 1.0) - 1.0))
        clock = EVERY_S * number + time
        moved = -1e-3 * nm_per_s * SETTLES_S * np.expm1(-clock / SETTLES_S)
        seen = play(volts, LIMITS, 0.0016) + moved + slow(rng, time.size)
        out.append(Sweep(
            f"sweep_{number + 1:04d}", volts, seen - seen[0], RATE, 1.0, 0.0, 1.0, 1, 0.0,
            f"0-{top:g}", number // len(TOPS) + 1, "virgin", EVERY_S * number, "SIMULATED",
        ))  # fmt: skip
    return out


def compared(sweeps):
    groups = group_tracks(prepare(sweeps), sweeps)
    return groups, without_settling(groups, starting_model(groups, (), "classical"))


def differs_nm(groups) -> float:
    """Rms of what two recordings of a drive differ by, offsets off."""
    off = [np.diff(g.measured_um, axis=0).ravel() for g in groups.groups]
    return 1e3 * float(np.sqrt(np.mean([(d - d.mean()) ** 2 for d in off])))


@pytest.mark.parametrize("seed", [1, 2])
def test_repeats_are_compared_without_a_drift_that_settles(seed):
    groups, settled = compared(session(seed, 30.0))
    _, quiet = compared(session(seed, 0.0))
    assert differs_nm(groups) > 1.5 * differs_nm(quiet)
    assert differs_nm(settled) == pytest.approx(differs_nm(quiet), rel=0.1)


def test_noise_alone_is_left_as_it_is():
    """But for one session in fifty, whose slopes happen to settle."""
    same = 0
    for seed in range(10):
        groups, settled = compared(session(100 + seed, 0.0))
        same += settled is groups
    assert same >= 9


def test_a_drive_that_stands_still_says_what_it_can():
    groups, _ = compared(session(1, 0.0))
    model = starting_model(groups, (), "classical")
    still = groups.with_([replace(g, drive_v=np.full_like(g.drive_v, 5.0)) for g in groups.groups])
    settled = without_settling(still, model)
    assert all(np.all(np.isfinite(g.measured_um)) for g in settled.groups)


def test_recordings_without_a_twin_are_left_as_they_are():
    groups, settled = compared(session(1, 30.0)[: len(TOPS)])
    assert settled is groups


@pytest.mark.study
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_drift_is_found(seed):
    found = diagnose(session(seed, 30.0))
    assert [f.cause for f in found.findings] == ["thermal-drift"]
    assert found.findings[0].parameters["rate"].value > 0.0
    assert found.rungs[-1].rms_nm < 1.25 * NOISE_NM
    assert not found.unexplained.detected


def two_of_two(seed: int, nm_per_s: float, noise) -> list[Sweep]:
    """Two drives, twice each, 400 s apart; a zero that settles within 500 s."""
    rng, out = np.random.default_rng(seed), []
    for number, (top, hertz) in enumerate(2 * [(75.0, 2.0), (60.0, 3.0)]):
        time = np.arange(8000) / RATE
        volts = top * (1.0 - np.abs(2.0 * ((hertz * time) % 1.0) - 1.0))
        clock = 400.0 * number + time
        moved = -1e-3 * nm_per_s * 500.0 * np.expm1(-clock / 500.0)
        seen = play(volts, LIMITS, 0.0016) + moved + noise(rng, time.size)
        out.append(Sweep(
            f"sweep_{number + 1:04d}", volts, seen - seen[0], RATE, 1.0, 0.0, 1.0, 1, 0.0,
            f"0-{top:g}", number // 2 + 1, "virgin", 400.0 * number, "SIMULATED",
        ))  # fmt: skip
    return out


def white(rng: np.random.Generator, n: int) -> np.ndarray:
    return 1e-3 * NOISE_NM * rng.standard_normal(n)


def wandering(rng: np.random.Generator, n: int) -> np.ndarray:
    """A zero that walks at random, 3 nm in the root of a second."""
    return white(rng, n) + 3e-3 * np.cumsum(rng.standard_normal(n)) / np.sqrt(RATE)


@pytest.mark.parametrize("seed", first_of(1, [1, 2, 3]))
def test_slopes_of_few_recordings_are_no_noise_where_nothing_else_is_slow(seed):
    groups, settled = compared(two_of_two(seed, 1.5, white))
    _, quiet = compared(two_of_two(seed, 0.0, white))
    assert differs_nm(groups) > 1.1 * differs_nm(quiet)
    assert differs_nm(settled) == pytest.approx(differs_nm(quiet), rel=0.01)


@pytest.mark.study
def test_slopes_of_a_zero_that_walks_at_random_are_noise():
    """But for one session in a hundred."""
    same = 0
    for seed in range(20):
        groups, settled = compared(two_of_two(100 + seed, 0.0, wandering))
        same += settled is groups
    assert same >= 19


@pytest.mark.study
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_drift_that_settles_is_found_in_two_recordings_of_two_drives(seed):
    found = diagnose(two_of_two(seed, 1.5, white))
    assert [f.cause for f in found.findings] == ["thermal-drift"]
    assert found.rungs[0].rms_nm > 1.2 * NOISE_NM
    assert found.rungs[-1].rms_nm < 1.1 * NOISE_NM


@pytest.mark.study
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_zero_that_goes_to_and_fro_is_no_noise(seed):
    """As by the air conditioning: neither steady nor settling, and repeats differ by it."""
    phase = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi)
    found = diagnose(recordings(
        sensor=lambda x, t, rng: x + 0.03 * 6.0 * np.sin(t / 6.0 + phase), repeats=3, seed=seed,
    ))  # fmt: skip
    assert found.unexplained.detected
    assert "clock" in found.unexplained.depends_on
    assert "the zero drifts" in found.unexplained.text


@pytest.mark.parametrize("seed", range(3))
def test_straight_lines_are_told_from_noise_by_their_size(seed):
    """Slopes of 20 nm/s rms beside 2 nm of white noise, and that noise alone."""
    steep = np.random.default_rng(seed).normal(0.0, 0.02, 12)
    for slopes in (steep, np.zeros(12)):
        own = iter(slopes)
        sweeps = recordings(
            sensor=lambda x, t, rng, own=own: x + next(own) * (t - t[0]), repeats=3, seed=seed
        )
        groups = group_tracks(prepare(sweeps, first_rises=True), sweeps)
        told = drifting(groups, starting_model(groups, named_model("classical"), "classical"))
        if slopes.any():
            off = slopes.reshape(3, 4) - slopes.reshape(3, 4).mean(axis=0)
            assert told.p_value < 1e-6
            assert told.rate_nm_s == pytest.approx(1e3 * off.std(), rel=0.1)
            assert told.noise_nm == pytest.approx(2.0, rel=0.05)
        else:
            assert told.p_value > 1e-3
