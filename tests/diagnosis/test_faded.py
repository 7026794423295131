"""Members that say nothing any more, once the laws beside them have moved, are dropped."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from small_bench import CONDITIONS, recordings
from spaces import begun, with_member
from test_findings import creep

from piezo_rig.causes import CAUSES
from piezo_rig.diagnosis import detours, spare
from piezo_rig.diagnosis.climb import Search
from piezo_rig.diagnosis.ladder import Ladder, Step
from piezo_rig.diagnosis.refit import refit
from piezo_rig.diagnosis.scan import Scan
from piezo_rig.diagnosis.spare import faded, one_by_one


def quiet(text):
    pass


def searching(space, first, steps, error_nm=2.0, helps=True):
    """A climb with these steps, whose every model leaves as much of what was held out."""
    return Search(space, first, np.random.default_rng(0), quiet, [(lambda f: error_nm, 1.0)], 2.0,
                  0, lambda less, full: helps, steps)  # fmt: skip


@pytest.fixture(scope="module")
def fitted():
    """Creep of 1 %, fitted by itself, and with a drift beside it that is not there."""
    space, plain = begun(recordings(creep(0.01), conditions=CONDITIONS[:2]))
    creeping = with_member(plain, "creep", {"rate_per_decade": 0.002}, rate_per_decade=0.01)
    one = refit(space, creeping, held=True)
    drifting = with_member(one.point, "thermal-drift", {"rate": 0.1}, rate=0.01)
    both = refit(space, drifting, held=True)
    return space, one, both


def test_a_member_that_faded_is_dropped_and_the_others_are_fitted_without_it(fitted):
    space, one, both = fitted
    steps = (Step("creep", 1e-9, one), Step("thermal-drift", 1e-4, both))
    ladder = faded(space, Ladder(one, steps, ()), quiet)
    assert [s.cause for s in ladder.steps] == ["creep"]
    assert [s.id for s in ladder.last.point.model.stages if s.id in CAUSES] == ["creep"]


def test_a_member_that_others_were_fitted_after_is_dropped_as_well(fitted):
    space, one, both = fitted
    drift = Step("thermal-drift", 1e-4, one)
    ladder = faded(space, Ladder(one, (drift, Step("creep", 1e-9, both)), ()), quiet)
    assert [s.cause for s in ladder.steps] == ["creep"]


def test_a_ladder_that_says_something_stays_itself(fitted):
    space, one, _ = fitted
    ladder = Ladder(one, (Step("creep", 1e-9, one),), ())
    assert faded(space, ladder, quiet) is ladder


def test_where_nothing_is_left_the_baseline_is_the_last_rung():
    space, plain = begun(recordings(conditions=CONDITIONS[:2]))
    first = refit(space, plain)
    drift = refit(space, with_member(plain, "thermal-drift", {"rate": 0.1}, rate=0.01), held=True)
    ladder = faded(space, Ladder(first, (Step("thermal-drift", 1e-4, drift),), ()), quiet)
    assert ladder.steps == ()
    assert ladder.last is first


def test_a_detour_may_need_one_member_more_than_what_it_goes_around(fitted, monkeypatch):
    space, one, both = fitted
    steps = [Step("creep", 1e-9, one), Step("thermal-drift", 1e-4, both)]
    search = Search(space, one, np.random.default_rng(0), quiet, [], 2.0, 0,
                    lambda less, full: True, steps)  # fmt: skip
    tried = []
    monkeypatch.setattr(Search, "forward", lambda self: tried.append(self.most))
    monkeypatch.setattr("piezo_rig.diagnosis.detours.worse", lambda *_: "predicts worse")
    monkeypatch.setattr(detours, "rivals_of", lambda *_: ["cycle-aging"])
    assert not detours.detour(search)
    assert tried == [3, 3]


@pytest.mark.parametrize(("error_nm", "doubted"), [(2.0, False), (2.1, False), (2.6, True)])
def test_a_member_that_is_alone_is_doubted_where_something_is_left(
    fitted, monkeypatch, error_nm, doubted
):
    space, one, _ = fitted
    tried = []
    monkeypatch.setattr(detours, "_one_by_one", lambda search: tried.append(search) or [])
    search = searching(space, one, [Step("creep", 1e-9, one)], error_nm)
    assert not detours.detour(search)
    assert bool(tried) == doubted


@pytest.mark.parametrize(("sure", "left", "helps", "kept"), [  # left: without it, with it
    (12.0, (300.0, 0.0), False, True),  # plain in any case
    (7.0, (300.0, 0.0), True, True),  # it explains the rest
    (7.0, (300.0, 7.0), True, True),  # or next to all of it
    (7.0, (300.0, 60.0), True, False),  # much is left beside it
    (7.0, (0.0, 0.0), True, False),  # nothing was amiss
    (7.0, (300.0, 0.0), False, False),  # it does not predict
    (3.0, (300.0, 0.0), True, False),  # it may be nothing at all
])  # fmt: skip
def test_a_faint_member_stays_where_it_explains_the_rest(
    fitted, monkeypatch, sure, left, helps, kept
):
    space, one, both = fitted
    steps = [Step("creep", 1e-9, one), Step("thermal-drift", 1e-4, both)]
    search = searching(space, one, steps, helps=helps)
    monkeypatch.setattr(spare, "certainties", lambda space, fitted, members: {
        c: sure if c == "thermal-drift" else 50.0 for c in members
    })  # fmt: skip
    monkeypatch.setattr(Search, "left_over", lambda self, fitted=None: (
        left[int(fitted is None or fitted is both)]
    ))  # fmt: skip
    spare.faint(search)
    assert search.causes == (["creep", "thermal-drift"] if kept else ["creep"])


@pytest.mark.parametrize(("then_nm", "now_nm", "again"), [
    (100.0, 60.0, False), (100.0, 40.0, True),
    # of 0.87 nm beside the noise 0.25 are left
    (2.18, 2.016, True), (2.18, 2.1, False),
])  # fmt: skip
def test_what_came_to_nothing_is_tried_again_with_half_of_what_was_left(
    fitted, then_nm, now_nm, again
):
    space, one, both = fitted
    errors = {id(one): then_nm, id(both): now_nm}
    search = Search(space, one, np.random.default_rng(0), quiet,
                    [(lambda f: errors[id(f)], 1.0)], 2.0, 0, lambda less, full: True)  # fmt: skip
    search.came_to_nothing("rate-dependence", one)
    search.accept(Step("creep", 1e-9, both))
    assert ("rate-dependence" not in search.barred) == again


@pytest.mark.parametrize(("beside_it", "names"), [
    ({"time-skew": 3.0, "clock-ratio": 1.0}, {"time-skew", "clock-ratio"}),  # it does for both
    ({"time-skew": 170.0, "clock-ratio": 30.0}, {"clock-ratio"}),  # a delay is there besides
    ({"time-skew": 170.0}, {"clock-ratio"}),  # what is not looked for any more
])  # fmt: skip
def test_a_rival_that_is_asked_for_as_much_beside_a_member_is_no_other_name_of_it(
    fitted, beside_it, names
):
    space, one, _ = fitted
    step = Step("initiation-stage", 1e-9, one, {"time-skew": 190.0, "clock-ratio": 180.0})
    search = Search(space, one, np.random.default_rng(0), quiet, [(lambda f: 2.0, 1.0)], 2.0, 0,
                    lambda less, full: True, [step])  # fmt: skip
    for _ in range(2):  # looking twice says the same
        search.without_others_names(
            SimpleNamespace(ids=tuple(beside_it), ratio=np.array(list(beside_it.values())))
        )
        assert set(search.steps[-1].rivals) == names


def test_a_rung_that_was_fitted_beside_the_same_members_is_kept(fitted):
    space, one, both = fitted
    told = []
    steps = [Step("creep", 1e-9, one), Step("thermal-drift", 1e-4, both)]
    kept = one_by_one(space, steps, told.append)
    assert [s.fitted for s in kept] == [one, both]
    assert told == []
    turned = [Step("thermal-drift", 1e-4, one), Step("creep", 1e-9, both)]
    first, last = one_by_one(space, turned, told.append)
    assert last.fitted is both
    stages = [s.id for s in first.fitted.point.model.stages if s.id in CAUSES]
    assert stages == ["thermal-drift"]
    assert told == ["refit up to thermal-drift, one by one"]


def test_a_detour_with_one_member_more_must_be_plainly_better(fitted, monkeypatch):
    space, one, both = fitted
    here = replace(one, evidence=0.0)
    monkeypatch.setattr(detours, "rivals_of", lambda *_: ["cycle-aging"])
    monkeypatch.setattr(detours, "_one_by_one", lambda search: [("creep", one, SCANNED)])
    monkeypatch.setattr("piezo_rig.diagnosis.detours.worse", lambda *_: None)
    for gained, better in ((10.0, False), (40.0, True)):
        found = [Step(c, 1e-9, replace(both, evidence=gained)) for c in THREE]
        monkeypatch.setattr(Search, "forward", lambda self, found=found: setattr(
            self, "steps", found
        ))  # fmt: skip
        steps = [Step(c, 1e-9, here) for c in THREE[:2]]
        search = Search(space, one, np.random.default_rng(0), quiet, [], 2.0, 0,
                        lambda less, full: True, steps)  # fmt: skip
        assert detours.detour(search) == better


@pytest.mark.parametrize(("keeps_its_force", "better"), [(False, True), (True, False)])
def test_a_detour_to_a_law_that_keeps_its_force_must_be_worth_that(
    fitted, monkeypatch, keeps_its_force, better
):
    """As where such a law is chosen at first; and a little more evidence is enough for others."""
    space, one, both = fitted
    here, there = replace(both, evidence=0.0), replace(both, evidence=10.0)
    monkeypatch.setattr(detours, "rivals_of", lambda *_: ["extremum-dependence"])
    monkeypatch.setattr(detours, "_one_by_one", lambda search: [("creep", one, SCANNED)])
    monkeypatch.setattr("piezo_rig.diagnosis.detours.worse", lambda *_: None)
    monkeypatch.setattr(detours, "carries", lambda f, id: (
        keeps_its_force and f is there and id == both.point.names[0][0]
    ))  # fmt: skip
    members = list(dict.fromkeys(id for id, _ in both.point.names))
    monkeypatch.setattr(Search, "forward", lambda self: setattr(
        self, "steps", [Step(c, 1e-9, there) for c in members]
    ))  # fmt: skip
    search = Search(space, one, np.random.default_rng(0), quiet, [], 2.0, 0,
                    lambda less, full: True, [Step(c, 1e-9, here) for c in members])  # fmt: skip
    assert detours.detour(search) == better


def test_a_detour_that_does_without_a_member_need_not_be_better(fitted, monkeypatch):
    space, one, both = fitted
    monkeypatch.setattr(Search, "forward", lambda self: None)
    monkeypatch.setattr("piezo_rig.diagnosis.detours.worse", lambda *_: None)
    monkeypatch.setattr(detours, "rivals_of", lambda *_: ["cycle-aging"])
    monkeypatch.setattr(detours, "_one_by_one", lambda search: [("thermal-drift", less, DRIFT)])
    for lost, better in ((1.0, True), (10.0, False)):
        less = replace(one, evidence=-lost)
        steps = [Step(c, 1e-9, replace(both, evidence=0.0)) for c in THREE[:2]]
        search = Search(space, one, np.random.default_rng(0), quiet, [], 2.0, 0,
                        lambda less, full: True, steps)  # fmt: skip
        assert detours.detour(search) == better


THREE = ("creep", "thermal-drift", "cycle-aging")
SCANNED, DRIFT = (
    Scan((id,), np.ones(1), np.zeros(1), np.ones(1), np.ones(1), {}) for id in THREE[:2]
)


@pytest.mark.parametrize(("goal", "scans"), [(-np.inf, 3), (100.0, 1), (15.0, 3)])
def test_a_climb_that_cannot_get_there_is_given_up(fitted, monkeypatch, goal, scans):
    space, one, both = fitted
    search = Search(space, replace(one, evidence=0.0), np.random.default_rng(0), quiet, [], 2.0, 0,
                    lambda less, full: True, goal=goal, most=3)  # fmt: skip
    looked = []

    def taken(self, *_):  # each gains 6
        looked.append(len(self.steps))
        self.steps.append(Step(THREE[len(self.steps)], 1e-9,
                               replace(both, evidence=6.0 * len(self.steps) + 6.0)))  # fmt: skip
        return True

    monkeypatch.setattr("piezo_rig.diagnosis.climb.scan", lambda *_: SimpleNamespace(result=DRIFT))
    monkeypatch.setattr("piezo_rig.diagnosis.climb.bend", taken)
    search.forward()
    assert len(looked) == scans


@pytest.mark.parametrize("members", [1, 2])  # that it comes back with; two are all it may have
def test_after_a_detour_that_was_not_to_go_on_the_climb_does(fitted, monkeypatch, members):
    space, one, both = fitted
    search = searching(space, one, [Step("creep", 1e-9, one)], error_nm=3.0)
    came_back = [Step("cycle-aging", 1e-9, both), Step("thermal-drift", 1e-9, both)][:members]
    went_on = []

    def forward(self):
        if self.aside:
            self.steps = came_back
        else:
            went_on.append([s.cause for s in self.steps])

    monkeypatch.setattr(Search, "forward", forward)
    monkeypatch.setattr(detours, "worse", lambda *_: None)
    monkeypatch.setattr(detours, "rivals_of", lambda *_: ["cycle-aging"])
    monkeypatch.setattr(detours, "_worth", lambda s: 100.0 if s.aside else 0.0)
    assert detours.detour(search)
    assert went_on == ([["cycle-aging", "thermal-drift"]] if members == 2 else [])


@pytest.mark.parametrize(("size", "gained", "kept"), [
    (14.0, 10.0, False), (14.0, 20.0, True), (18.0, 10.0, True),
])  # fmt: skip
def test_what_says_little_beside_a_larger_law_is_left_by_that_law(
    fitted, monkeypatch, size, gained, kept
):
    space, one, both = fitted
    steps = [Step("creep", 1e-9, one), Step("thermal-drift", 1e-4, both)]
    search = searching(space, one, steps)
    monkeypatch.setattr(spare, "strengths", lambda space, fitted, members: {
        c: size if c == "thermal-drift" else 50.0 for c in members
    })  # fmt: skip
    monkeypatch.setattr(
        spare, "refit", lambda *_, **__: replace(one, evidence=both.evidence - gained)
    )
    spare.clear(search)
    assert search.causes == (["creep", "thermal-drift"] if kept else ["creep"])
