"""What is left out, and why: never what is said to be as likely."""

from piezo_rig.diagnosis.diagnose import _but_for


def test_what_a_finding_cannot_be_told_from_is_not_left_out():
    refused = {"thermal-drift": "these data cannot show it", "creep": "says no more"}
    confused = {"direction-asymmetry": ["thermal-drift", "extremum-dependence"], "time-skew": []}
    assert _but_for(refused, confused) == {"creep": "says no more"}
    assert _but_for(refused, {}) == refused
