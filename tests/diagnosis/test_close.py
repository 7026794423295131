"""Which of the causes that a scan finds likely are refitted to compare."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from piezo_rig.causes import CAUSES
from piezo_rig.diagnosis.scan import CLOSE, RUN_OFF, Scan, by_speed, of_base

IDS = ("rate-dependence", "amplifier-lag", "time-skew", "creep", "range-dependence",
       "thermal-drift", "cycle-aging", "input-bend", "output-bend")  # fmt: skip
excesses = st.lists(st.floats(1.0, 1e4), min_size=len(IDS), max_size=len(IDS))


def close(excess):
    excess = np.array(excess)
    nothing = np.zeros(excess.size)
    scan = Scan(IDS, excess, nothing, excess, nothing, {})
    return [IDS[i] for i in scan.close(np.arange(excess.size))]


def test_those_that_are_told_by_speed_do_not_push_out_what_is_no_question_of_speed():
    # at one frequency a larger range is a faster drive: all of them come before the range
    found = close([400.0, 380.0, 300.0, 270.0, 256.0, 1.0, 1.0, 1.0, 1.0])
    assert found == ["rate-dependence", "amplifier-lag", "time-skew", "creep", "range-dependence"]


@given(excesses)
def test_the_likeliest_is_the_first_and_few_others_are_compared(excess):
    found = close(excess)
    assert excess[IDS.index(found[0])] == max(excess)
    assert len(found) == len(set(found))
    others = [id for id in found if not by_speed(id) and not of_base(id)]
    assert len(others) <= RUN_OFF
    assert all(excess[IDS.index(id)] >= CLOSE * max(excess) for id in others)


def test_the_ids_are_of_the_catalogue():
    assert set(IDS) <= set(CAUSES)
