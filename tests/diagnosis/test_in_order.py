"""Rungs stand in an order in which each takes something away, where there is one."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from piezo_rig.diagnosis import in_order as module
from piezo_rig.diagnosis.in_order import in_order
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
