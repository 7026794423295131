"""A form without a number of its own is tried as well, where it says about as much."""

from types import SimpleNamespace

import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.diagnosis import race
from piezo_rig.diagnosis.patience import Patience
from piezo_rig.diagnosis.put_in import AS_MUCH, plainer

DRIFT = "thermal-drift"
STEADY = (CAUSES[DRIFT].of(None, rate=0.1),)
SETTLING = (CAUSES[DRIFT].of(None, rate=0.1, settling=0.01),)
LATER = (CAUSES[DRIFT].of(None, rate=0.1, settling=0.04),)


def found(chosen, *forms):
    """``forms`` : examples, and what they gain by a linear look"""
    gained = [gain for _, gain in forms]
    listed = [([k], form) for k, (form, _) in enumerate(forms)]
    likelihood = SimpleNamespace(evidence=lambda columns: gained[columns[0]])
    return SimpleNamespace(
        chosen={DRIFT: listed[chosen]}, forms={DRIFT: listed}, asking=lambda id: likelihood
    )


@pytest.mark.parametrize(("less", "form"), [(0.3, STEADY), (AS_MUCH + 1.0, None)])
def test_a_steady_drift_is_tried_unless_one_that_settles_says_more(less, form):
    other = plainer(found(1, (STEADY, 187.0 - less), (SETTLING, 187.0), (LATER, 186.9)), DRIFT)
    assert (None if other is None else other[1]) == form


def test_one_that_settles_and_is_doubted_is_tried_steady_however_much_it_says():
    forms = found(1, (STEADY, 187.0 - 10.0 * AS_MUCH), (SETTLING, 187.0))
    assert plainer(forms, DRIFT) is None
    assert plainer(forms, DRIFT, doubted=True)[1] == STEADY


def test_a_steady_drift_that_says_most_has_no_plainer_form():
    assert plainer(found(0, (STEADY, 187.0), (SETTLING, 186.0)), DRIFT) is None


def test_where_all_forms_have_the_number_there_is_none():
    assert plainer(found(1, (SETTLING, 186.0), (LATER, 187.0)), DRIFT) is None


@pytest.mark.parametrize(("steady_nm", "settling_nm", "kept"), [
    (3.6, 15.8, "steady"),  # two recordings fit any settling, and a third is predicted anywhere
    (2.07, 2.01, "settling"),
])  # fmt: skip
def test_which_of_two_forms_it_is_what_was_held_out_says(
    monkeypatch, steady_nm, settling_nm, kept
):
    monkeypatch.setattr(race, "plainer", lambda found, id: ([0], STEADY))
    fitted = left_of_a_race(monkeypatch, steady_nm, settling_nm)
    assert fitted.name == kept


@pytest.mark.parametrize(("settling_nm", "kept"), [(194.0, "steady"), (60.0, "settling")])
def test_one_that_predicts_worse_than_nothing_is_tried_steady_where_that_says_less(
    monkeypatch, settling_nm, kept
):
    monkeypatch.setattr(
        race, "plainer", lambda found, id, doubted=False: ([0], STEADY) if doubted else None
    )
    fitted = left_of_a_race(monkeypatch, 19.0, settling_nm, 80.0)
    assert fitted.name == kept


def left_of_a_race(monkeypatch, steady_nm, settling_nm, here_nm=20.0):
    """Which of the two is left, of held-out errors such as these; ``here_nm`` : without either"""
    fits = {
        name: SimpleNamespace(name=name, error=nm, evidence=evidence, parts=(), point=0)
        for name, nm, evidence in (("steady", steady_nm, 186.9), ("settling", settling_nm, 187.1))
    }
    monkeypatch.setattr(race, "abreast", lambda space, steps, known: [step() for step in steps])
    monkeypatch.setattr(race, "at_a_limit", lambda *_: False)
    monkeypatch.setattr(race, "gained", lambda fitted, here: fitted.evidence - here.evidence)
    monkeypatch.setattr(race, "refitted", lambda space, here, found, i, form: (
        fits["settling" if form is None else "steady"]
    ))  # fmt: skip
    monkeypatch.setattr(race, "grown", lambda search, here, found, i, fitted, most: (
        fitted.evidence, fitted, None
    ))  # fmt: skip
    search = SimpleNamespace(
        patience=Patience(), space=SimpleNamespace(longest={}), tell=lambda text: None,
        error=lambda k, f: f.error
    )
    here = SimpleNamespace(evidence=0.0, parts=(), error=here_nm)
    drifts = SimpleNamespace(result=SimpleNamespace(ids=(DRIFT,)))
    ((_, _, fitted),) = race.tried(search, here, drifts, [0])
    return fitted
