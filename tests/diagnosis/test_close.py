"""Which of the causes that a scan finds likely are refitted to compare."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from piezo_rig.causes import CAUSES
from piezo_rig.diagnosis.scan import CLOSE, RUN_OFF, Scan, by_speed, of_base

IDS = ("rate-dependence", "amplifier-lag", "time-skew", "creep", "range-dependence",
       "thermal-drift", "cycle-aging", "input-bend", "output-bend")  # fmt: skip
excesses = st.lists(st.floats(1.0, 1e4), min_size=len(IDS), max_size=len(IDS))


def scan(excess):
    excess = np.array(excess)
    nothing = np.zeros(excess.size)
    return Scan(IDS, excess, nothing, excess, nothing, {}), np.arange(excess.size)


def close(excess):
    found, good = scan(excess)
    return [IDS[i] for i in found.close(good)]


def alike(excess):
    found, good = scan(excess)
    return [IDS[i] for i in found.alike(good)]


def test_those_that_are_told_by_speed_do_not_push_out_what_is_no_question_of_speed():
    # at one frequency a larger range is a faster drive: all of them come before the range
    excess = [400.0, 380.0, 300.0, 270.0, 256.0, 1.0, 1.0, 1.0, 1.0]
    assert close(excess) == ["rate-dependence", "creep", "range-dependence"]
    assert alike(excess) == ["amplifier-lag", "time-skew"]


def test_nothing_is_taken_for_a_cause_that_goes_by_speed_where_none_is_near():
    assert alike([300.0, 290.0, 1.0, 1000.0, 1.0, 1.0, 1.0, 1.0, 1.0]) == []


@given(excesses)
def test_of_those_that_go_by_speed_the_likeliest_is_refitted_first(excess):
    first, others = close(excess), alike(excess)
    fast = [id for id in first if by_speed(id)]
    assert len(fast) <= 1
    assert not set(first) & set(others)
    assert all(by_speed(id) for id in others)
    assert fast or not others
    assert all(excess[IDS.index(id)] <= excess[IDS.index(fast[0])] for id in others)


@given(excesses)
def test_the_likeliest_is_the_first_and_few_others_are_compared(excess):
    found = close(excess)
    assert excess[IDS.index(found[0])] == max(excess)
    assert len(found) == len(set(found))
    others = [id for id in found if not by_speed(id) and not of_base(id)]
    assert len(others) <= RUN_OFF
    named = max(e for id, e in zip(IDS, excess, strict=True) if not of_base(id))
    assert all(excess[IDS.index(id)] >= CLOSE * named for id in others)


def test_a_bend_is_nobodys_rival_for_a_place():
    # what bends most looks like one: the causes behind it are refitted all the same
    excess = [1.0, 1.0, 1.0, 12.0, 24.0, 20.0, 1.0, 1.0, 400.0]
    assert close(excess) == ["output-bend", "range-dependence", "thermal-drift", "creep",
                             "input-bend"]  # fmt: skip


def test_all_kinds_of_bend_are_refitted_where_one_is_near():
    others = [1.0, 1.1, 1.2, 20.0, 1.4, 1.5, 1.6]
    assert close([*others, 0.1, 40.0]) == ["output-bend", "creep", "input-bend"]
    assert close([*others, 0.1, 7.0]) == ["creep"]


def test_the_ids_are_of_the_catalogue():
    assert set(IDS) <= set(CAUSES)
