"""A given model is said to be asked for more than it knows where drives swing further."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Elements, Maxwell, Model, Parameter
from piezo_rig.chain.half_loops import half_loops
from piezo_rig.diagnosis.checks import baseline_warnings, beyond_its_drives
from piezo_rig.diagnosis.claimed import _only_believed
from piezo_rig.errors import InputError

REACH_V = 37.5  # thresholds up to half a swing of 75 V
MODEL = Model((Maxwell.of(Elements.from_curve(np.linspace(2.5, REACH_V, 15), np.full(15, 0.13))),))


def group(swing_v: float, virgin: bool) -> SimpleNamespace:
    rise = np.linspace(0.0, swing_v, 200)
    drive = np.concatenate([rise, rise[-2::-1], rise[1:], rise[-2::-1]])
    if not virgin:
        drive = drive + 3.0
    return SimpleNamespace(drive_v=drive, loops=half_loops(drive), virgin=virgin)


def said(
    *groups: SimpleNamespace, fixed: tuple[str, ...] = ("maxwell",), model: Model = MODEL
) -> list[str]:
    point = SimpleNamespace(model=model, fixed=fixed)
    return beyond_its_drives(SimpleNamespace(groups=groups), SimpleNamespace(point=point))


@pytest.mark.parametrize(("swing_v", "virgin", "expected"), [
    (75.0, False, 0), (40.0, False, 0), (100.0, False, 1),
    (37.0, True, 0), (75.0, True, 1),  # a first rise passes every threshold once, not twice
])  # fmt: skip
def test_drives_that_swing_further_than_the_elements_reach_are_said(swing_v, virgin, expected):
    assert len(said(group(swing_v, virgin))) == expected


def test_a_first_rise_of_its_own_is_what_first_rises_are_held_against():
    rise = Elements.from_curve(np.linspace(5.0, 75.0, 15), np.full(15, 0.11))
    own = MODEL.with_stage(CAUSES["initiation-stage"].of(rise))
    assert said(group(75.0, True), model=own) == []
    assert len(said(group(100.0, True), model=own)) == 1


def test_a_model_that_is_refitted_knows_whatever_is_played():
    assert said(group(100.0, False), fixed=()) == []


@pytest.mark.parametrize(("half", "expected"), [(0.6, False), (1.8, False), (2.3, True)])
def test_a_share_of_creep_that_the_data_say_nothing_of_is_not_shown(half, expected):
    creep = CAUSES["creep"].of(None, rate_per_decade=0.02)
    share = Parameter(1.0, "1", (1.0 - half, 1.0 + half))
    assert _only_believed(creep, "share_10s", share) == expected
    assert not _only_believed(creep, "rate_per_decade", share)


@pytest.mark.parametrize(("stood", "said_to_stand", "where"), [
    (2, 3, "one position lower than was said"), (3, 2, "one position higher than was said"),
])  # fmt: skip
def test_a_switch_that_was_said_to_stand_elsewhere_is_put_right(stood, said_to_stand, where):
    """Of the printed table: 3.87 and 15.48 um/V."""
    um_per_v = {2: 3.87, 3: 15.48}
    moved = np.linspace(0.0, 8.0, 300)
    read = moved / um_per_v[stood] * um_per_v[said_to_stand]
    data = SimpleNamespace(
        measured_um=read[None], blocks=((0, 300),), predicted=lambda model: moved,
    )  # fmt: skip
    point = SimpleNamespace(model=MODEL, fixed=("maxwell",))
    with pytest.raises(InputError, match="times what the baseline model predicts") as error:
        baseline_warnings(SimpleNamespace(groups=[data]), SimpleNamespace(point=point))
    assert where in error.value.cause
