"""Effects that hide each other: each is named, and nothing else."""

from __future__ import annotations

import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.studies.hidden import draw


@pytest.mark.study
def test_a_law_and_a_drift_neither_of_which_carries_over_alone_are_both_named():
    case = draw("pair", 907, "holds", "1/f")
    found = diagnose(case.sweeps)
    assert set(case.truth.causes) == {"range-dependence", "thermal-drift"}
    assert {f.cause for f in found.findings} == set(case.truth.causes)
    assert not found.unexplained.detected


@pytest.mark.study
def test_creep_and_a_drift_that_nearly_cancel_are_named_before_what_stands_in_for_both():
    case = draw("pair", 1500, "shuffled", "white", 100.0, 2, "A")
    found = diagnose(case.sweeps)
    assert [f.cause for f in found.findings] == ["creep", "thermal-drift"]
    assert not found.unexplained.detected
    for finding in found.findings:
        for name, true in case.truth.parameters[finding.cause].items():
            low, high = finding.parameters[name].ci95
            assert low < true < high


@pytest.mark.study
def test_without_repeats_the_condition_of_the_largest_range_does_not_speak_for_all():
    # left out it asks for extrapolation: 133 nm there, and 2 to 4 where the bend is right
    case = draw("pair", 1522, "holds", "white", 150.0, 1, "A")
    found = diagnose(case.sweeps)
    assert found.held_out == "condition"
    assert {f.cause for f in found.findings} == {"extremum-dependence", "thermal-drift"}
    assert not found.unexplained.detected


@pytest.mark.study
@pytest.mark.parametrize(("seed", "protocol", "noise", "repeats"), [
    (2000, "rates", "1/f", 2),  # a law of extrema that keeps its force fits as well, at its price
    (2000, "shuffled", "1/f", 2),  # the zero settles over the session
    (3000, "ramps", "1/f", 1),  # the cycles that are held out have no first rise
])
def test_of_two_that_look_like_others_each_is_named(seed, protocol, noise, repeats):
    case = draw("pair", seed, protocol, noise, 40.0, repeats)
    found = diagnose(case.sweeps)
    assert {f.cause for f in found.findings} == set(case.truth.causes)
    assert not found.unexplained.detected
