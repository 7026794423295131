"""What is dropped as faint may have stood where something else belongs, which is tried again."""

import pytest

from piezo_rig.diagnosis import spare as module
from piezo_rig.diagnosis.refusals import CAME_TO_NOTHING
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
