"""A number more has to say something before it is taken in."""

from types import SimpleNamespace

import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.diagnosis.put_in import AS_MUCH, _plainest

DRIFT = "thermal-drift"
STEADY = (CAUSES[DRIFT].of(None, rate=0.1),)
SETTLING = (CAUSES[DRIFT].of(None, rate=0.1, settling=0.01),)
LATER = (CAUSES[DRIFT].of(None, rate=0.1, settling=0.04),)


def found(chosen, *forms):
    """``forms`` : examples, and what they gain by a linear look"""
    gained = [gain for _, gain in forms]
    listed = [([k], form) for k, (form, _) in enumerate(forms)]
    return SimpleNamespace(
        chosen={DRIFT: listed[chosen]}, forms={DRIFT: listed},
        likelihood=SimpleNamespace(evidence=lambda columns: gained[columns[0]]),
    )


@pytest.mark.parametrize(("less", "form"), [(0.3, STEADY), (AS_MUCH + 1.0, SETTLING)])
def test_a_drift_settles_where_that_says_more(less, form):
    chosen = _plainest(found(1, (STEADY, 187.0 - less), (SETTLING, 187.0), (LATER, 186.9)), DRIFT)
    assert chosen[1] == form


def test_a_steady_drift_that_says_most_is_taken_as_it_is():
    assert _plainest(found(0, (STEADY, 187.0), (SETTLING, 186.0)), DRIFT)[1] == STEADY


def test_of_forms_that_all_have_the_number_the_best_is_taken():
    assert _plainest(found(1, (SETTLING, 186.0), (LATER, 187.0)), DRIFT)[1] == LATER
