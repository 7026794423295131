"""Effects that hide each other: each is named, and nothing else."""

from __future__ import annotations

from piezo_rig.diagnosis import diagnose
from piezo_rig.studies.hidden import draw


def test_a_law_and_a_drift_neither_of_which_carries_over_alone_are_both_named():
    case = draw("pair", 907, "holds", "1/f")
    found = diagnose(case.sweeps)
    assert set(case.truth.causes) == {"range-dependence", "thermal-drift"}
    assert {f.cause for f in found.findings} == set(case.truth.causes)
    assert not found.unexplained.detected
