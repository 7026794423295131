"""A detour that does not win may still be as good: its other member is then a rival."""

from types import SimpleNamespace

import pytest

from piezo_rig.causes.extremum_dependence import ExtremumDependence
from piezo_rig.diagnosis import detours
from piezo_rig.diagnosis.detours import with_stand_in
from piezo_rig.diagnosis.forms import CARRIES
from piezo_rig.diagnosis.ladder import Step


def ladder(evidence, *causes):
    point = SimpleNamespace(model=SimpleNamespace(stages=()))
    fitted = SimpleNamespace(evidence=evidence, point=point)
    return [Step(c, 0.0, fitted) for c in causes], fitted


@pytest.mark.parametrize(("short", "error", "as_good", "listed"), [
    (15.0, 3.84, False, True),  # less likely, and foretells more
    (15.0, 3.92, False, False),  # less likely, and foretells as much
    (25.0, 3.50, False, False),  # far less likely
    (3.0, 3.93, True, True),  # about as likely
])  # fmt: skip
def test_another_cause_in_the_place_of_one_is_listed_where_it_is_as_good(
    short, error, as_good, listed
):
    steps, _ = ladder(-4000.0, "initiation-stage", "thermal-drift", "bend")
    others, there = ladder(-4000.0 - short, "direction-asymmetry", "initiation-stage")
    search = SimpleNamespace(
        error=lambda _, fitted: error if fitted is there else 3.93,
        as_good=lambda *_: as_good,
    )
    found = with_stand_in(search, steps, others, there)
    assert [set(s.rivals) for s in found] == [
        set(), {"direction-asymmetry"} if listed else set(), set()
    ]  # fmt: skip
    assert [s.cause for s in found] == [s.cause for s in steps]


def test_two_causes_in_the_place_of_one_are_no_rival_of_it():
    steps, _ = ladder(-4000.0, "creep")
    others, there = ladder(-4001.0, "thermal-drift", "cycle-aging")
    search = SimpleNamespace(error=lambda *_: 1.0, as_good=lambda *_: True)
    assert with_stand_in(search, steps, others, there) == steps


def test_a_law_that_hangs_on_two_half_loops_is_compared_at_its_price():
    steps, here = ladder(-4000.0, "extremum-dependence")
    others, there = ladder(-4010.0, "range-dependence")
    stage = ExtremumDependence.of(None, slope=0.01, offset=0.0, reach=0.3, carries=1.0)
    here.point.model = SimpleNamespace(stages=(stage,), stage=lambda _: stage)
    asked = []
    search = SimpleNamespace(
        error=lambda *_: 1.0, as_good=lambda *given: asked.append(given[3]) or True,
    )
    found = with_stand_in(search, steps, others, there)
    assert asked == [10.0 - CARRIES]
    assert found[0].rivals == {"range-dependence": CARRIES - 10.0}


def test_the_only_member_of_a_detour_is_brought_to_its_best_though_a_bend_came_after_it(
    monkeypatch,
):
    steps, _ = ladder(-4000.0, "direction-asymmetry", "bend")
    search = SimpleNamespace(steps=steps, causes=["direction-asymmetry"], fitted=None, space=None)
    there, asked = SimpleNamespace(evidence=-3990.0), []
    monkeypatch.setattr(detours, "converged", lambda _, fitted: fitted)
    monkeypatch.setattr(detours, "summit", lambda _, fitted, id: asked.append(id) or there)
    monkeypatch.setattr(detours, "also", lambda *_: False)
    detours._at_its_best(search)
    assert asked == ["direction-asymmetry"]
    assert [s.cause for s in search.steps] == ["direction-asymmetry", "bend"]
    assert search.steps[-1].fitted is there
