"""Rivals of a finding that the data hardly tell from it are its alternatives."""

from types import SimpleNamespace

import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.climb import Search
from piezo_rig.studies.hidden import draw


@pytest.mark.parametrize(("behind", "error_nm", "id", "as_good"), [
    (7.0, 2.01, "direction-asymmetry", True),
    (9.0, 2.01, "direction-asymmetry", False),  # half the square of a d' of 4 is 8
    (7.0, 2.0205, "direction-asymmetry", True),  # by no more than chance
    (7.0, 2.0215, "direction-asymmetry", False),  # it predicts worse
    (7.0, 2.03, "direction-asymmetry", False),
    (1.0, 2.01, "initiation-stage", False),  # a table has many numbers to say it with
])  # fmt: skip
def test_what_says_hardly_less_and_predicts_no_worse_is_as_good(behind, error_nm, id, as_good):
    taken, rival = SimpleNamespace(evidence=100.0), SimpleNamespace(evidence=100.0 - behind)
    search = SimpleNamespace(error=lambda _, fitted: 2.02 if fitted is taken else error_nm)
    assert Search.as_good(search, rival, taken, id) == as_good


@pytest.mark.study
def test_a_direction_that_gains_with_every_loop_is_not_told_from_a_drift():
    """The case that asked for it: over a walk, beside an initiation stage."""
    out = diagnose(draw("pair", 9801, "walk", "white", 40.0).sweeps)
    named = [{f.cause, *f.alternatives} for f in out.findings]
    assert any("direction-asymmetry" in names for names in named)
    assert any("initiation-stage" in names for names in named)
