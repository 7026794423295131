"""Gain and sensitivity where a given model is wrong by more than tells the two apart."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from small_bench import CONDITIONS, actuator, drive_of, recordings

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.unlike import within_what_is_wrong
from piezo_rig.identification import identify

RATIO = 1.004
pytestmark = pytest.mark.study  # six seconds for what all of them ask
whole = importlib.import_module("piezo_rig.diagnosis.diagnose")


@pytest.fixture(scope="module")
def asked():
    """What a diagnosis of a wrong gain asks, and what it said."""
    calls = []

    def noted(*given):
        calls.append(given)
        return within_what_is_wrong(*given)

    model = identify(recordings(), "classical").model
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(whole, "within_what_is_wrong", noted)
        said = diagnose(recordings(before=lambda drive: RATIO * drive, repeats=3), model)
    (found,) = said.findings
    assert (found.cause, found.alternatives) == ("drive-gain", [])
    ((space, fitted, cause, _, noise_um),) = calls
    assert cause == "drive-gain"
    return space, fitted, noise_um


def test_a_gain_is_no_longer_told_from_a_scale_where_the_model_is_wrong_by_what_they_differ(asked):
    space, fitted, noise_um = asked
    play, effect, moved = actuator(), [], []
    for _, low, high in CONDITIONS:
        drive = drive_of(low, high)
        plain = play(drive)
        effect.append(play(RATIO * drive) - plain)
        moved.append(plain)
    effect, moved = (np.concatenate([x - x.mean() for x in rows]) for rows in (effect, moved))
    apart = np.std(effect - effect @ moved / (moved @ moved) * moved)
    assert apart > 5e-4  # um
    for share, alike in ((0.9, []), (1.1, ["sensor-scale"])):
        left = np.hypot(max(noise_um, space.own_um), share * apart)
        assert within_what_is_wrong(space, fitted, "drive-gain", left, noise_um) == alike


def test_noise_is_nothing_that_a_model_is_wrong_by(asked):
    space, fitted, _ = asked
    assert within_what_is_wrong(space, fitted, "drive-gain", 0.02, 0.02) == []


def test_causes_that_a_refitted_model_shows_have_no_such_rival(asked):
    space, fitted, noise_um = asked
    assert within_what_is_wrong(space, fitted, "creep", 1.0, noise_um) == []
