"""What is remembered of one model must not show in what another one does."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Elements, Maxwell, Memo, Model

TIME = np.arange(3000) * 1e-3
DRIVE = 30.0 - 30.0 * np.cos(2 * np.pi * 1.5 * TIME)
TABLE = Elements.from_curve(np.linspace(3.0, 40.0, 10), np.linspace(0.1, 0.16, 10))
STAGES = {
    "maxwell": lambda x: Maxwell.of(
        Elements.from_curve(TABLE.knots_v, (1.0 + 0.1 * x) / TABLE.slopes)
    ),
    "amplifier-lag": lambda x: CAUSES["amplifier-lag"].of(None, tau=1e-3 * (1.0 + x)),
    "range-dependence": lambda x: CAUSES["range-dependence"].of(
        None, slope=1e-3 * x, offset=0.0, reach=0.5
    ),
    "creep": lambda x: CAUSES["creep"].of(None, rate_per_decade=0.01 * x),
    "time-skew": lambda x: CAUSES["time-skew"].of(None, delay=1e-3 * x),
}


def model_of(values: dict[str, float]) -> Model:
    model = Model((STAGES["maxwell"](values["maxwell"]),))
    for id, value in values.items():
        if id != "maxwell":
            model = model.with_stage(STAGES[id](value))
    return model


sizes = st.floats(0.0, 1.0)


@given(
    st.fixed_dictionaries({"maxwell": sizes}, optional=dict.fromkeys(list(STAGES)[1:], sizes)),
    st.lists(st.tuples(st.sampled_from(sorted(STAGES)), sizes, st.booleans()), max_size=6),
    st.sampled_from(["virgin", "unknown"]),
)
def test_neighbours_of_a_remembered_model_do_what_they_do_alone(start, moves, history):
    memo, model = Memo(), model_of(start)
    memo.remember(model)
    for id, value, stay in moves:
        there = model.with_stage(STAGES[id](value))
        found = there.simulate(TIME, DRIVE, history, memo=memo)
        assert np.array_equal(found, there.simulate(TIME, DRIVE, history))
        if not stay:
            model = there
            memo.remember(model)
    assert np.array_equal(
        model.simulate(TIME, DRIVE, history, memo=memo), model.simulate(TIME, DRIVE, history)
    )


def test_a_stage_that_did_not_change_is_not_played_again(monkeypatch):
    memo, model = Memo(), model_of({"maxwell": 0.0, "creep": 1.0})
    memo.remember(model)
    model.simulate(TIME, DRIVE, memo=memo)
    late = model.with_stage(STAGES["time-skew"](1.0))
    alone = late.simulate(TIME, DRIVE)
    monkeypatch.setattr(CAUSES["creep"], "act", lambda *_: pytest.fail("creep was played again"))
    assert np.array_equal(late.simulate(TIME, DRIVE, memo=memo), alone)
