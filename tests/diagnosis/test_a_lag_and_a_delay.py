"""A lag for a delay beside what was found since, and both for one thing that goes by speed."""

from types import SimpleNamespace

import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis import late as module
from piezo_rig.diagnosis.ladder import Step
from piezo_rig.diagnosis.late import rather_the_other
from piezo_rig.studies.hidden import draw


def fit(evidence):
    return SimpleNamespace(evidence=evidence)


@pytest.mark.parametrize(("gained", "refused", "causes"), [
    (10.0, None, ["time-skew", "creep"]),
    (2.0, None, ["amplifier-lag", "creep"]),  # no more than chance
    (10.0, "predicts worse", ["amplifier-lag", "creep"]),
])  # fmt: skip
def test_a_delay_stays_in_a_lags_place_where_it_says_plainly_more(
    monkeypatch, gained, refused, causes
):
    there = fit(100.0 + gained)
    steps = [
        Step("amplifier-lag", 1e-9, fit(80.0), {"time-skew": 5.0}), Step("creep", 1e-8, fit(100.0))
    ]  # fmt: skip
    search = SimpleNamespace(
        steps=steps, fitted=steps[-1].fitted, barred={"time-skew": "beside it"}, rearranged=False
    )
    monkeypatch.setattr(module, "_the_others", lambda search: iter([(0, "time-skew", there)]))
    monkeypatch.setattr(module, "worse", lambda *_: refused)
    rather_the_other(search)
    assert [s.cause for s in search.steps] == causes
    swapped = causes[0] == "time-skew"
    assert search.rearranged == swapped
    assert (search.steps[-1].fitted is there) == swapped
    assert ("time-skew" in search.barred) != swapped


@pytest.mark.study
def test_a_delay_that_looked_like_a_lag_before_a_creep_was_known_is_named():
    case = draw("pair", 9901, "matrix", "white", 60.0)
    found = diagnose(case.sweeps)
    assert {f.cause for f in found.findings} == set(case.truth.causes) == {"creep", "time-skew"}
    (delay,) = (f.parameters["delay"].value for f in found.findings if f.cause == "time-skew")
    assert delay == pytest.approx(case.truth.parameters["time-skew"]["delay"], rel=0.1)
    assert not found.unexplained.detected


@pytest.mark.study
def test_a_large_lag_and_a_large_delay_are_no_rate_law():
    """Their sizes are not asked for: beside break points that were put in before, hardly told."""
    case = draw("pair", 9900, "one", "white", 60.0)
    found = diagnose(case.sweeps)
    assert {f.cause for f in found.findings} == set(case.truth.causes)
    assert case.truth.causes == ("time-skew", "amplifier-lag")
    assert not found.unexplained.detected
