"""What is refused for what it predicts, and where that is asked in vain."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.diagnosis.covered import first_rise_within
from piezo_rig.diagnosis.held_out import without_first_rises
from piezo_rig.diagnosis.refusals import OF_THE_MISFIT, worse


def group(drive, repeats=1, virgin=True):
    return SimpleNamespace(drive_v=np.asarray(drive, float), virgin=virgin, repeats=repeats)


FALLING = [0.0, 60.0, 0.0, 50.0, 0.0, 40.0, 0.0]
GROWING = [0.0, 40.0, 0.0, 50.0, 0.0, 60.0, 0.0]


def test_a_first_rise_ends_where_the_drive_has_been_furthest_from_rest():
    assert first_rise_within(group(FALLING), 2)
    assert not first_rise_within(group(FALLING), 1)
    assert not first_rise_within(group(GROWING), 4)
    assert first_rise_within(group([-v for v in FALLING]), 2)
    assert not first_rise_within(group(FALLING, virgin=False), 2)


@pytest.mark.parametrize(("drive", "groups", "repeats", "asked_in_vain"), [
    (FALLING, 1, 1, True), (GROWING, 1, 1, False),
    (FALLING, 1, 2, False),  # whole recordings are held out, first rise and all
    (FALLING, 2, 1, False),  # or sweeps
])  # fmt: skip
def test_where_held_out_cycles_have_no_first_rise(drive, groups, repeats, asked_in_vain):
    space = SimpleNamespace(
        groups=SimpleNamespace(groups=[group(drive, repeats)] * groups),
        pieces=[SimpleNamespace(first=0, fold=0), SimpleNamespace(first=4, fold=1)],
    )
    assert without_first_rises(space) == asked_in_vain


def fitted(evidence, *ids):
    stages = [CAUSES[id].of(None, **dict.fromkeys(CAUSES[id].units, 0.0)) for id in ids]
    return SimpleNamespace(
        evidence=evidence, point=SimpleNamespace(model=SimpleNamespace(stages=stages))
    )


@pytest.mark.parametrize(("id", "gained", "left_nm", "refused"), [
    ("periodic-nonlinearity", 340.0, 5.99, False),
    ("periodic-nonlinearity", 40.0, 5.99, True),  # not plain
    ("creep", 340.0, 5.99, True),  # a model that is far off makes up for much by it
    ("creep", 340.0, 3.0, False),
])  # fmt: skip
def test_only_what_is_like_no_other_is_named_while_a_model_stays_far_off(
    id, gained, left_nm, refused
):
    before, after = fitted(0.0), fitted(gained, id)
    errors = {0.0: 6.0, gained: left_nm}
    search = SimpleNamespace(
        held_out=[(None, 1.03)], noise_nm=2.0, space=SimpleNamespace(loose=False),
        error=lambda k, f: errors[f.evidence],
    )  # fmt: skip
    assert (worse(search, after, before) == OF_THE_MISFIT) == refused
