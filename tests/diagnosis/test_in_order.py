"""Rungs stand in an order in which each takes something away, where there is one."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from piezo_rig.diagnosis import in_order as module
from piezo_rig.diagnosis.in_order import bends_first, in_order
from piezo_rig.diagnosis.ladder import Ladder, Step


def model(*members):
    """A fit with these members, which forgets one where it is asked to."""
    return SimpleNamespace(members=frozenset(members), point=SimpleNamespace(
        without=lambda id: frozenset(members) - {id}))  # fmt: skip


@pytest.mark.parametrize(("errors", "order"), [
    ({"": 9.0, "a": 11.0, "ab": 4.0, "b": 5.0}, "ba"),  # b lowers it alone, a beside it
    ({"": 9.0, "a": 11.0, "ab": 4.0, "b": 9.5}, "ab"),  # neither does alone
    ({"": 9.0, "a": 7.0, "ab": 4.0, "b": 5.0}, "ab"),  # nothing is raised
    ({"": 9.0, "a": 9.01, "ab": 4.0, "b": 5.0}, "ab"),  # by no more than chance
    ({"": 9.0, "a": 7.0, "ab": 8.0, "abc": 3.0, "ac": 4.0}, "acb"),
    ({"": 9.0, "a": 12.0, "ab": 13.0, "abc": 3.0, "b": 8.0, "bc": 3.5}, "bca"),
])  # fmt: skip
def test_what_raises_the_error_comes_after_what_it_needs(monkeypatch, errors, order):
    made = []

    def refit(space, members, held):
        made.append(members)
        return model(*members)

    monkeypatch.setattr(module, "refit", refit)
    longest = max(errors, key=len)
    every = [longest[: k + 1] for k in range(len(longest))]
    ladder = Ladder(model(), tuple(Step(m[-1], 0.0, model(*m)) for m in every), ())
    found = in_order(
        None, ladder, lambda f: errors["".join(sorted(f.members))], lambda text: None
    )
    assert "".join(s.cause for s in found.steps) == order
    for k, step in enumerate(found.steps):  # each fitted with those before it
        assert step.fitted.members == frozenset(order[: k + 1])
    assert found.steps[-1].fitted.members == frozenset(longest)


@pytest.mark.parametrize(("alone", "order"), [
    (8.0, ["bend", "creep", "time-skew"]),
    (9.04, ["bend", "creep", "time-skew"]),  # no worse than by chance
    (11.0, ["creep", "bend", "time-skew"]),  # alone it spoils what was held out
])  # fmt: skip
def test_a_bend_of_the_base_comes_before_causes(monkeypatch, alone, order):
    def one_by_one(space, steps, tell):
        members = [s.cause for s in steps]
        return [
            Step(s.cause, s.p_value, model(*members[: k + 1])) for k, s in enumerate(steps)
        ]

    monkeypatch.setattr(module, "one_by_one", one_by_one)
    causes = ["creep", "bend", "time-skew"]
    ladder = Ladder(model(), tuple(
        Step(c, 0.0, model(*causes[: k + 1])) for k, c in enumerate(causes)
    ), ())  # fmt: skip
    errors = {frozenset(): 9.0, frozenset({"bend"}): alone}
    found = bends_first(None, ladder, lambda f: errors[f.members], lambda text: None)
    assert [s.cause for s in found.steps] == order
    for k, step in enumerate(found.steps):
        assert step.fitted.members == frozenset(order[: k + 1])
