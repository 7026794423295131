"""An actuator that ages with every cycle of the session, whatever recording it belongs to."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from tests.diagnosis.small_bench import CONDITIONS, recordings

CYCLES = 3  # of every recording, as `small_bench` plays them


def aged(rate, begins_anew=False):
    """An effect on the strain of one recording after the other; ramps count as well."""
    played = [0.0]

    def effect(x, drive, t):
        way = np.cumsum(np.abs(np.diff(drive, prepend=drive[0])))
        turns = np.flatnonzero(np.diff(np.sign(np.diff(drive))) != 0).size + 1
        count = 0.5 * turns * way / way[-1]
        before = 0.0 if begins_anew else played[0]
        played[0] += 0.5 * turns
        return x * (1.0 + rate * np.log10(1.0 + before + count))

    return effect


def shuffled(seed=3):
    order = np.random.default_rng(seed).permutation(len(CONDITIONS))
    return tuple(CONDITIONS[k] for k in order)


@pytest.mark.study
@pytest.mark.parametrize("rate", [0.004, -0.002])
def test_ageing_through_a_session_is_named_and_sized(rate):
    found = diagnose(recordings(aged(rate), conditions=shuffled()))
    (finding,) = found.findings
    assert finding.cause == "cycle-aging"
    assert finding.parameters["session"].value == 1.0
    assert finding.parameters["rate_per_decade"].value == pytest.approx(rate, rel=0.1)
    assert not found.unexplained.detected
    # what repeats differ by through it is no noise
    assert found.noise_floor_nm == pytest.approx(2.0, rel=0.05)


@pytest.mark.study
def test_ageing_that_begins_anew_is_told_from_it():
    found = diagnose(recordings(aged(0.006, begins_anew=True), conditions=shuffled()))
    (finding,) = found.findings
    assert finding.cause == "cycle-aging"
    assert finding.parameters["session"].value == 0.0


def test_nothing_ages_in_an_actuator_that_does_not():
    assert diagnose(recordings(conditions=shuffled())).findings == []


@pytest.mark.study
@pytest.mark.parametrize(("rate", "seed"), [(-0.0015, 0), (0.002, 1)])
def test_ageing_that_noise_hides_in_every_recording_is_seen_in_all_of_them(rate, seed):
    found = diagnose(recordings(
        aged(rate), repeats=3, kind="1/f", seed=seed, conditions=shuffled()
    ))  # fmt: skip
    (finding,) = found.findings
    assert finding.cause == "cycle-aging"
    value = finding.parameters["rate_per_decade"]
    assert value.value == pytest.approx(rate, rel=0.25)
    assert value.ci95[0] < rate < value.ci95[1]
    assert not found.unexplained.detected


@pytest.mark.study
def test_a_gain_that_is_not_steady_for_another_reason_is_no_ageing():
    per_mille = (0.0, -1.0, 1.5, -2.0, 1.0, -1.5, 0.5, 1.0, -0.5, 0.0, -1.5, 0.0)
    gains = iter([1.0 + 1e-3 * p for p in per_mille])

    def wobbling(x, drive, t):
        return x * next(gains)

    found = diagnose(recordings(wobbling, repeats=3, conditions=shuffled()))
    assert "cycle-aging" not in [f.cause for f in found.findings]
    assert found.unexplained.detected


TWO = CONDITIONS[2], CONDITIONS[1]


@pytest.mark.study
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_repeats_of_two_drives_are_enough_to_see_it(seed):
    (finding,) = diagnose(recordings(aged(0.0015), repeats=3, seed=seed, conditions=TWO)).findings
    assert finding.cause == "cycle-aging"
    assert finding.parameters["rate_per_decade"].value == pytest.approx(0.0015, rel=0.25)


@pytest.mark.study
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_gain_that_creeps_along_through_two_drives_is_no_ageing(seed):
    gains = iter(1.0 + 3e-4 * np.arange(3 * len(TWO)))
    found = diagnose(recordings(
        lambda x, drive, t: x * next(gains), repeats=3, seed=seed, conditions=TWO
    ))  # fmt: skip
    assert found.findings == []
    assert found.unexplained.detected
