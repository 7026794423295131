"""What all repeats share in a band of frequencies is no noise."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.causes import named_model
from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.bands import Band, shared_band
from piezo_rig.diagnosis.fit import starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.unexplained import Unexplained, with_band
from piezo_rig.identification import prepare
from piezo_rig.run_file import Sweep
from tests.diagnosis.small_bench import recordings

RATE, RINGS_HZ, RINGS_UM = 2000.0, 240.0, 1.5e-3
TIME = np.arange(4000) / RATE


def session(rings_um, noise, seed):
    """Two sines, three times each, of a spring; what rings does so in all repeats alike."""
    rng, out = np.random.default_rng(seed), []
    for number in range(6):
        hz = (1.0, 3.0)[number % 2]
        drive = 35.0 * (1.0 - np.cos(2.0 * np.pi * hz * TIME))
        along = np.sin(2.0 * np.pi * (RINGS_HZ + 0.2 * drive) * TIME)
        x = 0.12 * drive + rings_um * along + noise(rng, TIME.size)
        out.append(Sweep(
            f"sweep_{number + 1:04d}", drive, x - x[0], RATE, 1.0, 0.0, 1.0, 1, 0.0, f"{hz:g} Hz",
            number // 2 + 1, "virgin", 10.0 * number, "SIMULATED",
        ))  # fmt: skip
    return out


def white(rng, n):
    return 3e-3 * rng.standard_normal(n)


def slow(rng, n):
    return 3e-3 * np.cumsum(rng.standard_normal(n)) / np.sqrt(n)


def exact(rng, n):
    return np.zeros(n)


def told(sweeps):
    groups = group_tracks(prepare(sweeps, first_rises=True), sweeps)
    return shared_band(groups, starting_model(groups, named_model("classical"), "classical"))


@pytest.mark.parametrize("noise", [white, slow])
def test_it_is_found_where_it_is_with_its_size(noise):
    band = told(session(RINGS_UM, noise, 1))
    assert band.p_value < 1e-9
    assert band.low_hz < 1.1 * RINGS_HZ < band.high_hz
    assert band.rms_nm < 1e3 * RINGS_UM / np.sqrt(2.0)
    assert band.rms_nm > 0.5 * 1e3 * RINGS_UM / np.sqrt(2.0)


@pytest.mark.parametrize("noise", [white, slow])
def test_noise_alone_makes_none_unlikely(noise):
    chances = [told(session(0.0, noise, seed)).p_value for seed in range(20)]
    assert sum(p < 0.05 for p in chances) <= 4
    assert min(chances) > 1e-3


def test_exact_data_that_a_model_has_are_no_band():
    groups = group_tracks(prepare(session(0.0, exact, 1), first_rises=True), session(0.0, exact, 1))
    model = starting_model(groups, named_model("classical"), "classical")
    predicted = groups.with_([
        g.with_measured(np.tile(g.predicted(model), (3, 1))) for g in groups.groups
    ])  # fmt: skip
    assert shared_band(predicted, model).rms_nm == 0.0


def test_where_nothing_is_repeated_nothing_is_shared():
    assert told(session(RINGS_UM, white, 1)[:2]) is None


@pytest.mark.parametrize(("detected", "rms_nm", "said"), [
    (False, 1.0, True), (False, 0.3, False), (True, 1.0, False),
])  # fmt: skip
def test_it_is_said_where_nothing_else_is_and_it_is_worth_a_word(detected, rms_nm, said):
    rest = Unexplained(detected, 0.5, 0.1, 0.2, [], "")
    out = with_band(rest, Band(1e-9, 200.0, 280.0, rms_nm), 2.0)
    assert ("all repeats share" in out.text) == said
    assert out.detected == (detected or said)


@pytest.mark.study
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_what_moves_with_the_drive_and_rings_is_unexplained(seed):
    def ringing(x, drive, t):
        return x + 2e-3 * np.sin(2.0 * np.pi * (240.0 + 0.5 * drive) * (t - t[0]))

    found = diagnose(recordings(ringing, seed=seed))
    assert found.findings == []
    assert found.unexplained.detected
    assert "frequency" in found.unexplained.depends_on
