"""What looks promise and refits keep: others are tried, alone or two at once, and tables."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from piezo_rig.diagnosis import climb, climbed, in_doubt, own_laws, race
from piezo_rig.diagnosis.climbed import Climbed

IDS = ("time-skew", "rate-dependence", "creep", "output-bend", "initiation-stage")
DELAY, RATE, CREEP, BEND, FIRST = range(5)


@pytest.mark.parametrize(("fits", "wanted"), [
    ({DELAY: 7.7}, [RATE, CREEP]),  # of a promised 21 the delay has kept 7.7
    ({DELAY: 12.0}, [RATE]),
    ({DELAY: 25.0}, []),
    ({DELAY: 7.7, RATE: 3.0}, [CREEP]),
    ({}, []),  # nothing was close
])  # fmt: skip
def test_what_promised_more_than_the_best_kept_is_refitted(fits, wanted):
    result = SimpleNamespace(
        ids=IDS, excess=np.array([21.0, 13.0, 9.0, 30.0, 8.5]),
        p_family=np.array([1e-9, 1e-6, 1e-4, 1e-9, 0.3]),
    )  # fmt: skip
    tried = [(worth, i, None) for i, worth in fits.items()]
    assert race._promising(result, tried) == wanted


@pytest.mark.parametrize(("errors_nm", "worth", "asked"), [
    ((5.7, 5.9), (11.0, 9.0), RATE),  # either explains some
    ((5.7, 5.9), (9.0, 11.0), CREEP),
    ((5.97, 5.9), (11.0, 9.0), CREEP),  # the likelier one next to nothing
    ((5.99, 5.99), (11.0, 9.0), None),
    ((5.7, 5.9), (-1.0, -2.0), None),
])  # fmt: skip
@pytest.mark.parametrize("aside", [False, True])
def test_the_likeliest_that_explains_some_is_tried_with_one_more(
    monkeypatch, errors_nm, worth, asked, aside
):
    here, (rate, creep), seen = object(), (object(), object()), []
    error = {id(here): 6.0, id(rate): errors_nm[0], id(creep): errors_nm[1]}
    search = SimpleNamespace(
        error=lambda _, fitted: error[id(fitted)], noise_nm=3.8, level=1.0, aside=aside
    )
    fits = [(worth[0], RATE, rate), (worth[1], CREEP, creep)]
    monkeypatch.setattr(in_doubt, "tried", lambda *_: fits)
    monkeypatch.setattr(in_doubt, "begun_steep", lambda *_: [])
    monkeypatch.setattr(
        in_doubt, "beside", lambda search, here, first: seen.append(first.cause) or True
    )
    found = SimpleNamespace(result=SimpleNamespace(ids=IDS, excess=np.zeros(5)))
    family = np.full(5, 1e-4)
    expected = [] if asked is None or aside else [IDS[asked]]
    assert in_doubt.explained(search, here, found, family, 1e-9) == bool(expected)
    assert seen == expected
    assert not in_doubt.explained(search, here, found, family, 0.5)  # nothing may be left


@pytest.mark.parametrize(("likeliest", "worth", "rival"), [
    (FIRST, [76.5], 76.5), (FIRST, [], 0.0), (RATE, [76.5], 0.0),
])  # fmt: skip
def test_a_table_is_refitted_before_a_law_does_more_in_its_place(
    monkeypatch, likeliest, worth, rival
):
    told = []
    monkeypatch.setattr(climb, "also", lambda *a: told.append(a[3]()) or True)
    monkeypatch.setattr(climb, "tried", lambda *_: [(w, FIRST, None) for w in worth])
    search = SimpleNamespace()
    found = SimpleNamespace(result=SimpleNamespace(ids=IDS))
    assert climb.Search.let_go(search, object(), 1.0, found, likeliest)
    assert told == [rival]


@pytest.mark.parametrize(("rival", "taken"), [(40.0, True), (70.0, False)])
def test_a_law_does_more_only_where_that_is_worth_more_than_a_rival(monkeypatch, rival, taken):
    class Law(own_laws.Cause):
        id, scanned = "law", ("", 1.0)

        def also(self, context):
            return [self]

    law = Law.__new__(Law)
    object.__setattr__(law, "parameters", {"slope": 1.0})
    here = SimpleNamespace(evidence=0.0, point=SimpleNamespace(
        model=SimpleNamespace(stage=lambda id: law, with_stage=lambda form: None), fixed=(),
        sizes=(),
    ))  # fmt: skip
    more = SimpleNamespace(evidence=64.0)
    search = SimpleNamespace(
        causes=["law"], tell=lambda text: None, steps=[SimpleNamespace(fitted=here)],
        space=SimpleNamespace(linear=lambda *_: None), rearranged=False,
    )  # fmt: skip
    for name in ("context_of", "settle", "reduce", "all_free", "Point", "worse", "prune"):
        monkeypatch.setattr(own_laws, name, lambda *_: None)
    monkeypatch.setattr(own_laws, "Likelihood", lambda _: SimpleNamespace(
        evidence=lambda columns=(): 50.0 * len(columns)
    ))  # fmt: skip
    monkeypatch.setattr(own_laws, "descended", lambda *_: more)
    monkeypatch.setattr(own_laws, "replace", lambda step, fitted: SimpleNamespace(fitted=fitted))
    assert own_laws.also(search, here, 25.0, lambda: rival) == taken
    assert (search.steps[-1].fitted is more) == taken


@pytest.mark.parametrize(("interval", "of_these", "of_others"), [
    ([-0.05, 2.4], True, False),  # 1.17 % in both of two recordings, and as it is known from them
    ([0.3, 2.1], True, True), ([-0.6, 3.0], False, False),
])  # fmt: skip
def test_what_these_recordings_are_predicted_better_by_new_ones_need_not(
    monkeypatch, interval, of_these, of_others
):
    """Those differ as well: the half width is that of both together, root 2 times that of one."""
    monkeypatch.setattr(climbed, "gain", lambda *_: (1.17, interval))
    search = SimpleNamespace(judged="sweep", errors=lambda fitted: None)
    assert Climbed.helps(search, None, None) == of_others
    assert Climbed.helps(search, None, None, others=False) == of_these
