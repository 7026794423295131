"""Intervals of laws of the first spring where their reach is hardly known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.reaches import _interval
from piezo_rig.studies.hidden import draw


def test_one_fit_alone_has_the_interval_of_a_normal_law():
    assert _interval(np.ones(1), [(3.0, 0.5)]) == pytest.approx((2.02, 3.98), abs=1e-3)


def test_two_fits_far_apart_have_one_tail_each():
    low, high = _interval(np.array([0.5, 0.5]), [(0.0, 1.0), (100.0, 2.0)])
    assert low == pytest.approx(stats.norm.ppf(0.05), abs=1e-6)
    assert high == pytest.approx(100.0 + 2.0 * stats.norm.ppf(0.95), abs=1e-6)


def test_a_fit_that_the_data_hardly_allow_counts_little():
    low, high = _interval(np.array([0.999, 0.001]), [(0.0, 1.0), (50.0, 1.0)])
    assert (low, high) == pytest.approx((-1.96, 1.97), abs=0.02)


@pytest.mark.study
def test_a_law_that_may_hold_far_or_near_has_a_constant_part_that_is_as_uncertain():
    case = draw("extremum-dependence", 900, "matrix", "white", d_prime=40.0)
    true = case.truth.parameters["extremum-dependence"]
    (finding,) = diagnose(case.sweeps).findings
    reach = finding.parameters["reach"]
    assert reach.ci95[1] > 1.5 * reach.ci95[0] > 0.0
    for name in ("slope", "offset"):
        low, high = finding.parameters[name].ci95
        assert low < true[name] < high


@pytest.mark.study
def test_a_spring_that_is_several_times_as_hard_after_a_large_range_is_no_initiation_stage():
    # the case that asked for it: from a small slope no descent leads to this one
    case = draw("range-dependence", 1301, "rates", "ar", 40.0)
    found = diagnose(case.sweeps)
    assert [f.cause for f in found.findings] == ["range-dependence"]
    assert not found.unexplained.detected
    true = case.truth.parameters["range-dependence"]["slope"]
    assert found.findings[0].parameters["slope"].value == pytest.approx(true, rel=0.15)
