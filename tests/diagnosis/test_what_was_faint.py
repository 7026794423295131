"""What is dropped as faint may have stood where something else belongs, which is tried again."""

from types import SimpleNamespace

import pytest

from piezo_rig.diagnosis import spare as module
from piezo_rig.diagnosis.ladder import Step
from piezo_rig.diagnosis.refusals import BESIDE, CAME_TO_NOTHING
from piezo_rig.diagnosis.spare import less_what_is_faint


class Search:
    """Takes in the likeliest that is not barred; all but the drift are faint."""

    def __init__(self, left, barred):
        self.causes, self.barred, self.left, self.looks = ["range-dependence"], barred, left, 0
        self.likeliest = ["extremum-dependence", "direction-asymmetry", "thermal-drift"]
        self.forward()
        self.looks = 0

    def forward(self):
        self.looks += 1
        free = [c for c in self.likeliest if c not in self.barred]
        self.causes = [*self.causes, *free[:1]]

    def left_over(self):
        return 0.0 if "thermal-drift" in self.causes else self.left


def faint(search):
    for id in ("extremum-dependence", "direction-asymmetry"):
        if id in search.causes:
            search.causes = [c for c in search.causes if c != id]
            search.barred[id] = "not needed beside range-dependence"


@pytest.mark.parametrize(("left", "causes", "looks"), [
    (30.0, ["range-dependence", "thermal-drift"], 2),
    (0.0, ["range-dependence"], 0),  # nothing is left that would ask for it
])  # fmt: skip
def test_what_was_refused_beside_it_is_tried_again(monkeypatch, left, causes, looks):
    monkeypatch.setattr(module, "faint", faint)
    search = Search(left, {"thermal-drift": "once refitted it says no more", "creep": "at a limit"})
    less_what_is_faint(search)
    assert search.causes == causes
    assert search.looks == looks


def test_what_came_to_nothing_is_not_tried_again(monkeypatch):
    monkeypatch.setattr(module, "faint", faint)
    search = Search(30.0, {"thermal-drift": CAME_TO_NOTHING})
    less_what_is_faint(search)
    assert search.causes == ["range-dependence"]


class Member:
    """A ladder of one member, without which what is held out is predicted better."""

    def __init__(self, barred):
        self.space, self.barred, self.tell = None, barred, lambda _: None
        model = SimpleNamespace(without=lambda _: None)
        self.fitted = self.first = SimpleNamespace(point=model, evidence=0.0)
        self.less = SimpleNamespace(point=model, evidence=0.0)
        self.steps = [Step("initiation-stage", 0.0, self.fitted)]

    @property
    def causes(self):
        return [s.cause for s in self.steps]

    def left_over(self):
        return 0.0

    def helps(self, *_):
        return False


def test_what_was_not_needed_beside_a_member_may_be_once_that_is_dropped(monkeypatch):
    """A first rise of its own stands in for a memory, and helps as little to predict."""
    search = Member({
        "remanence": f"{BESIDE}initiation-stage", "creep": f"{BESIDE}thermal-drift",
    })  # fmt: skip
    monkeypatch.setattr(module, "far_off", lambda _: True)
    monkeypatch.setattr(module, "without_first_rises", lambda _: False)
    monkeypatch.setattr(module, "refit", lambda *_, **__: search.less)
    monkeypatch.setattr(module, "_gained_nothing", lambda _: [])
    monkeypatch.setattr(module, "like_no_other", lambda *_: False)
    assert module.idle(search)
    assert search.steps == []
    assert set(search.barred) == {"initiation-stage", "creep"}
