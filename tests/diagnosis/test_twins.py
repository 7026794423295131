"""Laws that do nearly the same in the data at hand are refitted and listed together."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Elements, Maxwell, Model
from piezo_rig.diagnosis import climb, twins
from piezo_rig.diagnosis.context import at_one_frequency, at_one_range
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.ladder import Step
from piezo_rig.diagnosis.refit import laws_of
from piezo_rig.identification import prepare
from piezo_rig.run_file import Sweep

RANGE, EXTREMUM, RATE = "range-dependence", "extremum-dependence", "rate-dependence"
FIRST = "initiation-stage"
RATE_HZ = 2000.0


def groups_of(*plays):
    """Triangles from 0 V: (highest drive, frequency) of each recording."""
    sweeps = []
    for k, (high, hz) in enumerate(plays):
        half = round(RATE_HZ / hz / 2)
        up = high * np.arange(half) / half
        drive = np.tile(np.concatenate([up, high - up]), 3)
        sweeps.append(Sweep(
            f"sweep_{k + 1:04d}", drive, 0.1 * drive, RATE_HZ, 1.0, 0.0, 1.0, 1, 0.0,
            f"0-{high} at {hz:g}", 1, "virgin", 60.0 * k, "IMPORTED",
        ))  # fmt: skip
    return group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)


ONE = groups_of((20, 2.0), (40, 2.0), (75, 2.0))
SEVERAL = groups_of((20, 2.0), (40, 2.0), (75, 4.0), (75, 1.0))


def test_loops_of_one_frequency_are_told_from_others():
    assert at_one_frequency(ONE)
    assert not at_one_frequency(SEVERAL)
    # equally fast, so those that go further take longer
    assert not at_one_frequency(groups_of((20, 7.5), (75, 2.0)))


def test_one_is_the_twin_of_the_other_at_one_frequency_alone():
    assert twins.are_twins(ONE, RANGE, RATE)
    assert twins.are_twins(ONE, RATE, RANGE)
    assert not twins.are_twins(SEVERAL, RANGE, RATE)
    for other in (EXTREMUM, "creep", "amplifier-lag", "time-skew", RANGE):
        assert not twins.are_twins(ONE, RANGE, other)


def test_a_first_rise_is_the_twin_of_a_law_of_the_range_of_equal_loops_alone():
    equal, fewer = groups_of((40, 2.0), (40, 2.0)), groups_of((20, 2.0), (40, 2.0))
    assert at_one_range(equal)
    assert at_one_range(groups_of((75, 1.0), (75, 4.0)))
    assert not at_one_range(fewer)
    assert not at_one_range(groups_of((40, 2.0), (44, 2.0)))
    assert twins.are_twins(equal, FIRST, RANGE)
    assert twins.are_twins(equal, RANGE, FIRST)
    assert not twins.are_twins(fewer, FIRST, RANGE)
    assert not twins.are_twins(equal, FIRST, EXTREMUM)


@pytest.mark.parametrize(("range_nm", "listed"), [(2.0110, [RANGE]), (2.0126, []), (None, [])])
def test_a_law_of_the_range_that_foretells_as_well_as_a_first_rise_is_listed(range_nm, listed):
    """What was refitted: no law is begun for it anew, nor a table, which follows everything."""
    error = {"first": 2.0112, "range": range_nm}
    search = SimpleNamespace(
        space=SimpleNamespace(groups=groups_of((40, 2.0), (40, 2.0))),
        error=lambda _, fitted: error[fitted],
    )
    candidates = [SimpleNamespace(id=id, variants=()) for id in (RANGE, EXTREMUM, "creep")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(twins, "candidates", lambda *_: (candidates, {}))
        refits = {} if range_nm is None else {RANGE: "range"}
        here = SimpleNamespace(point=SimpleNamespace(model=None))
        found = twins.foretelling_as_well(search, here, "first", FIRST, refits, 1.0005)
    assert found == listed


def fitted_with(id, carries=0.0):
    more = {"reach": 0.3, "carries": carries} if id in (RANGE, EXTREMUM) else {}
    numbers = {"lag_um": 0.01, "exponent": 0.7} if id == RATE else {"slope": 0.01, "offset": 0.0}
    stage = CAUSES[id].of(None, **numbers, **more)
    return SimpleNamespace(point=SimpleNamespace(
        model=SimpleNamespace(stage=lambda other: stage if other == id else None)
    ))  # fmt: skip


@pytest.mark.parametrize(("groups", "fits", "wanted"), [
    (SEVERAL, [(30.0, EXTREMUM, 1.0)], [RANGE]),
    (SEVERAL, [(30.0, EXTREMUM, 0.0)], []),
    (SEVERAL, [(-1.0, EXTREMUM, 1.0)], []),  # which is worth nothing
    (SEVERAL, [(30.0, RANGE, 0.0)], []),
    (ONE, [(30.0, RANGE, 0.0)], [RATE]),
    (ONE, [(30.0, RANGE, 0.0), (9.0, RATE, 0.0)], []),
    (ONE, [(30.0, RANGE, 1.0)], [EXTREMUM, RATE]),
])  # fmt: skip
def test_what_may_do_the_same_is_refitted_as_well(groups, fits, wanted):
    ids = ("creep", EXTREMUM, FIRST, RANGE, RATE)
    search = SimpleNamespace(space=SimpleNamespace(groups=groups), barred={})
    tried = [(w, ids.index(id), fitted_with(id, carries)) for w, id, carries in fits]
    found = twins.twins_of(search, SimpleNamespace(ids=ids), tried)
    assert [ids[i] for i in found] == wanted
    search.barred = dict.fromkeys(wanted, "it came out at a limit")
    assert twins.twins_of(search, SimpleNamespace(ids=ids), tried) == []


@pytest.mark.parametrize(("groups", "refitted_nm", "plain_nm", "listed"), [
    (ONE, 3.026, 3.2, True),
    (ONE, 3.264, 3.037, True),  # only where least squares ends: other effects hold it back
    (ONE, None, 3.037, True),  # its refit came to nothing
    (ONE, 3.264, 3.1, False),
    (SEVERAL, 3.026, 3.026, False),
])
def test_a_twin_that_foretells_as_well_is_listed(
    monkeypatch, groups, refitted_nm, plain_nm, listed
):
    range_nm, asked = 3.067, []
    stage = CAUSES[RATE].of(None, lag_um=0.005, exponent=0.3, window_s=6e-4)
    candidates = [SimpleNamespace(id=RATE, variants=((stage,),)),
                  SimpleNamespace(id=EXTREMUM, variants=())]  # fmt: skip
    monkeypatch.setattr(twins, "candidates", lambda *_: (candidates, {}))
    monkeypatch.setattr(twins, "replace", lambda point, model: model)
    monkeypatch.setattr(twins, "all_free", lambda model, stage: stage)

    class Plain:
        point = "where it ended"

        def __str__(self):
            return "plain"

    monkeypatch.setattr(twins, "refit", lambda space, begun, plain: asked.append(begun) or Plain())
    error = {"range": range_nm, "rate": refitted_nm, "plain": plain_nm}
    search = SimpleNamespace(
        space=SimpleNamespace(groups=groups), error=lambda _, fitted: error[str(fitted)]
    )
    here = SimpleNamespace(point=SimpleNamespace(model=SimpleNamespace(with_stage=lambda s: s)))

    class Rate:
        point = SimpleNamespace(model=SimpleNamespace(stage=lambda _: stage))

        def __str__(self):
            return "rate"

    refits = {} if refitted_nm is None else {RATE: Rate()}
    found = twins.foretelling_as_well(search, here, "range", RANGE, refits, 1.0005)
    assert found == ([RATE] if listed else [])
    if groups is ONE and not listed:  # from where it is, and from what is usual
        begun = [s for s in asked if s != Plain.point]
        assert [s["window_s"] for s in begun] == [6e-4, pytest.approx(stage.usual()["window_s"])]
        assert begun[1]["exponent"] == 0.7


@pytest.mark.parametrize(("errors", "reaches", "descents"), [
    ([4.2, 4.1, 4.05], True, 3),
    ([4.2, 4.1999], False, 2),
    ([4.2, 4.15, 4.3], False, 3),
    (np.linspace(5.0, 4.2, twins.DESCENTS), False, twins.DESCENTS),
])
def test_least_squares_goes_on_as_long_as_it_predicts_better(
    monkeypatch, errors, reaches, descents
):
    points = []

    def refit(space, point, plain):
        points.append(point)
        return SimpleNamespace(point=point + 1)

    monkeypatch.setattr(twins, "refit", refit)
    search = SimpleNamespace(space=None, error=lambda _, fitted: errors[fitted.point - 1])
    assert twins._reaches(search, 0, 4.06) is reaches
    assert points == list(range(descents))


def test_a_twin_that_is_asked_for_beside_the_other_is_no_other_effect(monkeypatch):
    step = Step(RANGE, 1e-9, None, {RATE: 22.0, FIRST: 22.0})
    search = SimpleNamespace(steps=[step], space=SimpleNamespace(groups=ONE))
    asked = SimpleNamespace(ids=(RATE, FIRST), ratio=np.array([20.0, 20.0]))
    climb.Search.without_others_names(search, asked)
    assert set(search.steps[-1].rivals) == {RATE}
    search.steps, search.space.groups = [step], SEVERAL
    climb.Search.without_others_names(search, asked)
    assert set(search.steps[-1].rivals) == set()


@pytest.mark.parametrize(("groups", "more"), [(ONE, True), (SEVERAL, False)])
def test_at_one_frequency_a_law_of_the_speed_leaves_open_what_one_of_the_range_does(
    groups, more, monkeypatch
):
    tags = ["frequency", "range", "direction", "clock"]
    monkeypatch.setattr("piezo_rig.diagnosis.refit.changed_um", lambda *_: 0.5)
    monkeypatch.setattr("piezo_rig.diagnosis.refit.playable", lambda *_: True)
    table = Maxwell.of(Elements(np.array([4.0, 3.0]), np.array([0.2, 99.0])))
    rate = CAUSES[RATE].of(None, lag_um=0.01, exponent=0.7)
    space = SimpleNamespace(groups=groups, tags=tags)
    found = np.sqrt(laws_of(space, Model((table, rate)))) / 0.5
    wider = CAUSES[RANGE].law
    assert found == pytest.approx(
        [CAUSES[RATE].law["frequency"], *((wider[t] if more else 0.0) for t in tags[1:3]), 0.0]
    )
