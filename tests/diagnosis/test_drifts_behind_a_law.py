"""A drift beside a law of turning points: either spoils what the other alone may predict."""

from types import SimpleNamespace

import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.diagnosis import detours
from piezo_rig.diagnosis.put_in import plainer

DRIFT, LAW, AGEING = "thermal-drift", "direction-asymmetry", "cycle-aging"


def refused(cause, evidence):
    return SimpleNamespace(cause=cause, fitted=SimpleNamespace(evidence=evidence))


@pytest.mark.parametrize(("spoiled", "works", "tried"), [
    ({LAW: 20.0, DRIFT: 5.0}, None, [LAW, DRIFT]),
    ({LAW: 20.0, DRIFT: 5.0}, LAW, [LAW]),
    ({LAW: 20.0, AGEING: 5.0}, None, [LAW]),
    ({DRIFT: 20.0, LAW: 5.0}, None, [DRIFT]),
])  # fmt: skip
def test_beside_the_likeliest_a_drift_is_tried(monkeypatch, spoiled, works, tried):
    asked = []

    def beside(search, here, first):
        asked.append(first.cause)
        return first.cause == works

    monkeypatch.setattr(detours, "_beside", beside)
    search = SimpleNamespace(
        aside=False, spoiled={c: refused(c, e) for c, e in spoiled.items()}
    )
    assert detours.together(search, None) == (works is not None)
    assert asked == tried
    assert search.spoiled == {}


@pytest.mark.parametrize(("doubted", "less_likely", "is_plain"), [
    (False, 1.0, True), (False, 30.0, False), (True, 30.0, True),
])  # fmt: skip
def test_a_form_that_is_doubted_is_tried_without_its_number(doubted, less_likely, is_plain):
    kind = CAUSES[DRIFT]
    settles, steady = kind.of(None, rate=2.0, settling=0.3), kind.of(None, rate=2.0)
    forms = [([0], (settles,)), ([1], (steady,))]
    likelihood = SimpleNamespace(evidence=lambda columns: -less_likely * columns[0])
    found = SimpleNamespace(
        chosen={DRIFT: forms[0]}, forms={DRIFT: forms}, asking=lambda _: likelihood
    )
    assert (plainer(found, DRIFT, doubted) == forms[1]) == is_plain

