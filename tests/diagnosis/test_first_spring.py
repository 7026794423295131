"""The constant part of a law, moved from the element table to the law, moves nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Elements, Maxwell, Model
from piezo_rig.diagnosis.first_spring import spring_of, without_offset

LATER, FIRST = [0.9, 0.6, 0.5, 0.4, 0.3, 0.2, 5.0], [0.7, 0.2, 0.5, 0.3, 0.4, 0.1, 5.5]


def table(springs):
    return Elements(np.array(springs), 0.3 * np.arange(1.0, len(springs) + 1))


@pytest.mark.parametrize("form", [
    {}, {"reach": 0.4}, {"reach": 0.7, "taper": 1.0}, {"reach": 0.25, "closing": 1.0},
    {"reach": 0.35, "closing": 1.0, "taper": 1.0},
])  # fmt: skip
@pytest.mark.parametrize("id", ["range-dependence", "extremum-dependence"])
def test_a_law_with_its_offset_plays_as_the_law_without_it_and_the_table_it_was_in(id, form):
    law = CAUSES[id].of(None, slope=0.004, offset=0.0, **form)
    rise = CAUSES["initiation-stage"].of(table(FIRST))
    before = Model((Maxwell.of(table(LATER)), rise, law))
    moved = without_offset(table(LATER), law, 0.8)
    after = Model((Maxwell.of(moved), rise, law.with_values(offset=0.8)))
    turns = [0.0, 60.0, 20.0, 55.0, 54.0, 54.8, 10.0, 33.0, 5.0, 70.0, 0.0]
    drive = np.interp(np.linspace(0.0, 10.0, 4001), np.arange(11.0), turns)
    time = np.arange(drive.size) / 5e3
    expected = before.simulate(time, drive)
    np.testing.assert_allclose(after.simulate(time, drive), expected, rtol=0, atol=1e-11)


def branch(slope_at) -> Elements:
    """A table whose later branch has this slope, V/um, that far after the turning point, um."""
    ends = np.linspace(0.005, 4.0, 800)
    return Elements.from_slopes(slope_at(ends - 0.0025), 0.5 * ends)


def test_a_spring_beside_elements_that_give_way_far_later_is_found_as_it_is():
    table = branch(lambda x: np.where(x < 0.5, 7.8, 7.0))
    assert spring_of(table, 0.5) == pytest.approx(0.8, rel=1e-6)


@given(st.floats(0.1, 1.5), st.floats(0.2, 0.8))
def test_what_gives_way_behind_the_reach_is_hardly_taken_for_the_spring(spring, reach):
    def falling(x):  # by 1 V/um for every um: right behind the reach less has given way
        return np.where(x < reach, 8.0 + spring, 8.0 - (x - reach))

    table = branch(falling)
    mean_after = 0.5 * reach  # by which the slope right behind the reach is above the mean there
    found = spring_of(table, reach)
    assert spring - 0.02 < found < spring + mean_after
    assert found == pytest.approx(spring + 0.5 * mean_after, abs=0.02)
