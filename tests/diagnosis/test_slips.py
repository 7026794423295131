"""Steps where the drive turns are no noise, however slow that is."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.causes.rate_dependence import REFERENCE_V_PER_S
from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.refit import refit
from piezo_rig.diagnosis.slips import Slips, open_nm, slips
from piezo_rig.diagnosis.unexplained import Unexplained, with_slips
from tests.diagnosis.sliders import play, recorded
from tests.diagnosis.spaces import begun
from tests.diagnosis.two_drives import LIMITS, noise
from tests.more import first_of

RATE, SLEW_V_PER_S, NOISE_UM = 1000.0, 400.0, 4e-3


def walk(seed: int, colour: str, slip_um: float, every: int = 3):
    """Random turning points behind a rise to 75 V; every third time that it turns a seat slips."""
    rng = np.random.default_rng(seed)
    lows, highs = rng.uniform(0.0, 30.0, 20), rng.uniform(40.0, 75.0, 20)
    turns = np.concatenate([[0.0, 75.0, 0.0], np.stack([highs, lows], axis=1).ravel(), [0.0]])
    lengths = [round(abs(b - a) / SLEW_V_PER_S * RATE) for a, b in pairwise(turns)]
    at = np.concatenate([[0], np.cumsum(lengths)])
    drive = np.interp(np.arange(at[-1] + 1), at, turns)
    slipped = np.zeros(drive.size)
    for k in range(every, at.size - 1, every):
        slipped[at[k] :] += slip_um * rng.standard_normal()
    seen = play(drive, LIMITS, 0.0016) + slipped
    if colour == "walk":
        return drive, seen + NOISE_UM * (
            noise(rng, drive.size, "white") + 0.05 * np.cumsum(rng.standard_normal(drive.size))
        )
    return drive, seen + NOISE_UM * noise(rng, drive.size, colour)


def recordings(seed, colour, slip_um):
    return [recorded(*walk(10 * seed + k, colour, slip_um), RATE, "unknown", k, f"walk {k}")
            for k in range(3)]  # fmt: skip


def seen_in(sweeps):
    space, point = begun(sweeps)
    return slips(space, refit(space, point))


@pytest.mark.parametrize("colour", first_of(1, ["walk", "white", "ar"]))
def test_steps_at_turning_points_are_seen(colour):
    """Of 15 nm at every third of them: 9 nm rms at all."""
    found = seen_in(recordings(1, colour, 0.015))
    assert found.p_value < 1e-5
    assert found.step_nm == pytest.approx(15.0 / np.sqrt(3.0), rel=0.4)


@pytest.mark.parametrize("colour", ["white", "ar", "walk"])
@pytest.mark.parametrize("seed", first_of(1, range(4)))
def test_noise_makes_none(colour, seed):
    assert seen_in(recordings(seed, colour, 0.0)).p_value > 0.004


def test_few_turning_points_say_nothing():
    drive = np.concatenate([np.linspace(0.0, 70.0, 2000), np.linspace(70.0, 0.0, 2000)])
    seen = play(drive, LIMITS, 0.0016) + NOISE_UM * noise(np.random.default_rng(0), 4000, "white")
    assert seen_in([recorded(drive, seen, RATE)]) is None


def test_recordings_that_hardly_turn_among_others_are_left_alone():
    drive = np.concatenate([np.linspace(0.0, 70.0, 700), np.linspace(70.0, 0.0, 700)])
    one = recorded(drive, play(drive, LIMITS, 0.0016), RATE, "unknown", 9, "a triangle")
    assert seen_in([*recordings(1, "white", 0.015), one]).p_value < 1e-5


LAG_UM = 0.02


@pytest.fixture(scope="module")
def lagging():
    """A space and a fit with a lag of 20 nm, whose sign is that of the speed."""
    space, point = begun(recordings(1, "white", 0.0))
    stage = CAUSES["rate-dependence"].of(None, lag_um=LAG_UM, exponent=0.7, window_s=1e-4)
    fitted = refit(space, point)
    with_it = fitted.point.model.with_stage(stage)
    return space, replace(fitted, point=replace(fitted.point, model=with_it)), fitted


def test_where_a_lag_turns_over_a_tenth_of_it_may_be_left(lagging):
    space, behind, fitted = lagging
    size_nm = 1e3 * LAG_UM * (SLEW_V_PER_S / REFERENCE_V_PER_S) ** 0.7
    assert open_nm(space, behind) == pytest.approx(0.1 * size_nm, rel=0.1)
    assert open_nm(space, fitted) == 0.0


@pytest.mark.parametrize(("left_open_nm", "said"), [(0.0, True), (2.0, True), (3.5, False)])
def test_steps_are_said_beyond_what_laws_leave_open(left_open_nm, said):
    rest = Unexplained(False, 0.4, 0.1, 0.5, [], "")
    found = with_slips(rest, Slips(1e-12, 9.0, 3.0), 4.0, left_open_nm)
    assert found.detected == said


@pytest.mark.study
def test_a_diagnosis_says_so():
    out = diagnose(recordings(2, "white", 0.015))
    assert out.unexplained.detected
    assert "slips" in out.unexplained.text
