"""Causes beside the most common ones, hidden on the independent bench: found and named."""

from __future__ import annotations

from piezo_rig.diagnosis import diagnose
from piezo_rig.studies.hidden import draw


def holds(parameter, true):
    low, high = parameter.ci95
    # half as wide again: one interval of 95 % in twenty misses, one so widened in three hundred
    return abs(true - 0.5 * (low + high)) < 1.5 * 0.5 * (high - low)


def test_travel_that_grows_with_the_cycles_played_is_ageing():
    case = draw("cycle-aging", 1, "rates", "white", d_prime=60.0, form="A")
    (finding,) = diagnose(case.sweeps).findings
    assert finding.cause == "cycle-aging"
    true = case.truth.parameters["cycle-aging"]["rate_per_decade"]
    assert holds(finding.parameters["rate_per_decade"], true)
