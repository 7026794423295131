"""Several drives that are played at once are what each of them is alone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause, Context
from piezo_rig.chain import Elements, Maxwell, Memo, Model
from piezo_rig.chain.bend import Bend
from piezo_rig.chain.drives import Drives
from piezo_rig.errors import InputError

RATE = 1000.0
TABLE = Elements.from_curve(np.linspace(3.0, 90.0, 12), np.linspace(0.1, 0.16, 12))
BASE = Model((Maxwell.of(TABLE),))
LATER = {"range-dependence": {"reach": 0.5, "ties": 1.0}, "rate-dependence": {"widens": 1.0}}


def drive(top: float, hertz: float, seconds: float, begin: float) -> tuple[np.ndarray, np.ndarray]:
    time = np.arange(round(seconds * RATE)) / RATE
    saw = np.abs(2.0 * ((hertz * time) % 1.0) - 1.0)
    return begin + time, top * (1.0 - saw)


def stages() -> dict[str, list]:
    """Examples of every cause, several times as large as the ones that are looked for."""
    slews = np.array([100.0, 300.0])
    context = Context(
        BASE, 9.0, 70.0, slews, 1.0 / RATE, 1.5, RATE, 75.0, 3.0, (5.0, 75.0), (0.0, 5.0)
    )
    out = {"bend": [Bend.none(0.0, 70.0).with_values(square=0.2, cube=-0.1)]}
    for id, kind in CAUSES.items():
        if not issubclass(kind, Cause) or kind.locked_to != "drive":
            continue
        found = [form[-1] for form in kind.variants(context)]
        out[id] = [*found, found[0].with_values(**LATER[id])] if id in LATER else found
    return out


STAGES = stages()
PLAYS = [
    (*drive(40.0, 2.0, 1.3, 0.0), "virgin"), (*drive(70.0, 3.0, 1.0, 5.0), "unknown"),
    (*drive(25.0, 1.0, 1.7, 2.0), "virgin"), (*drive(60.0, 5.0, 0.9, -1.0), "carried"),
]  # fmt: skip


def each_alone(model: Model, plays: list) -> np.ndarray:
    return np.concatenate([model.simulate(*play) for play in plays])


@pytest.mark.parametrize("id", sorted(STAGES))
def test_every_cause_knows_where_one_drive_ends_and_the_next_begins(id):
    drives = Drives.of(PLAYS)
    plain = each_alone(BASE, PLAYS)
    for stage in STAGES[id]:
        model = BASE.with_stage(stage)
        alone = each_alone(model, PLAYS)
        np.testing.assert_allclose(model.simulate_each(drives), alone, rtol=1e-12, atol=1e-12)
    if id not in ("remanence", "resonance"):  # which know of earlier drives, of faster samples
        assert np.max(np.abs(alone - plain)) > 1e-6


@given(
    st.lists(st.sampled_from(sorted(STAGES)), max_size=4, unique=True),
    st.lists(st.sampled_from(range(len(PLAYS))), min_size=1, max_size=5), st.booleans(),
)  # fmt: skip
@settings(deadline=None)
def test_so_do_models_of_several_and_in_any_order(ids, order, remembered):
    model = BASE
    for id in ids:
        model = model.with_stage(STAGES[id][0])
    plays, memo = [PLAYS[k] for k in order], Memo()
    drives = Drives.of(plays)
    if remembered:
        memo.remember(BASE)
        BASE.simulate_each(drives, memo)
    np.testing.assert_allclose(
        model.simulate_each(drives, memo), each_alone(model, plays), rtol=1e-12, atol=1e-12
    )


def test_a_gap_in_one_of_them_is_refused():
    time, volts = drive(40.0, 2.0, 1.0, 0.0)
    broken = volts.copy()
    broken[100] = np.nan
    with pytest.raises(InputError, match="not a number at sample 100"):
        Drives.of([(time, volts, "virgin"), (time, broken, "virgin")])
