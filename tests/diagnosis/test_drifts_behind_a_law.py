"""A drift beside a law of turning points: either spoils what the other alone may predict."""

from types import SimpleNamespace

import pytest

from piezo_rig.diagnosis import detours

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

    monkeypatch.setattr(detours, "beside", beside)
    search = SimpleNamespace(
        aside=False, spoiled={c: refused(c, e) for c, e in spoiled.items()}
    )
    assert detours.together(search, None) == (works is not None)
    assert asked == tried
    assert search.spoiled == {}
