"""Sizes of causes whose law is assumed: another law, as likely, gives another size."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.causes.creep import SHARES
from piezo_rig.chain import Parameter
from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.claimed import _of_any_form
from tests.diagnosis.small_bench import CONDITIONS, RATE, recordings, relaxation
from tests.more import first_of

RATE_PER_DECADE, BEGINS_S = 0.006, 0.03


def test_a_rate_that_is_measured_decade_by_decade_is_no_law_any_more():
    creep = CAUSES["creep"]
    assumed = creep.of(None, rate_per_decade=0.01)
    measured = creep.of(None, rate_per_decade=0.01, **dict.fromkeys(SHARES, 1.0))
    assert assumed.by_form == {"rate_per_decade": 0.1}
    assert measured.by_form == {}
    assert CAUSES["time-skew"].of(None, delay=1e-4).by_form == {}


def test_errors_of_a_fit_and_of_a_law_add_in_quadrature():
    fitted = Parameter(0.01, "1", (0.009, 0.012))  # known to 8 %
    half = 1.96 * 0.1 * 0.01
    low, high = _of_any_form(fitted, 0.1).ci95
    assert low == pytest.approx(0.01 - np.sqrt(0.001**2 + half**2))
    assert high == pytest.approx(0.01 + np.sqrt(0.002**2 + half**2))
    sure = Parameter(0.01, "1", (0.00999, 0.01001))  # to 0.05 %: a tenth would be seen
    low, high = _of_any_form(sure, 0.1).ci95
    assert (low, high) == pytest.approx([0.01 - 1e-5 * 10.0**0.5, 0.01 + 1e-5 * 10.0**0.5])
    assert _of_any_form(fitted, 0.0) == fitted
    assert _of_any_form(Parameter(0.01, "1"), 0.1).ci95 is None


@pytest.mark.parametrize("seed", first_of(0, [0, 1]))
def test_a_rate_of_another_law_is_in_its_interval(seed):
    """One that begins at 30 ms, four relaxations a decade, each driven by the displacement."""
    def effect(x, drive, t):
        out = x.copy()
        for tau in BEGINS_S * 10.0 ** np.arange(0.0, 4.0, 0.25):
            out += RATE_PER_DECADE / 4.0 * relaxation(x - x[0], tau, RATE)
        return out

    found = diagnose(recordings(effect=effect, seed=seed, conditions=CONDITIONS[1:3]))
    (own,) = found.findings
    assert own.cause == "creep"
    low, high = own.parameters["rate_per_decade"].ci95
    assert low < RATE_PER_DECADE < high
    value = own.parameters["rate_per_decade"].value
    assert (high - low) / value < 0.6  # and says something all the same
