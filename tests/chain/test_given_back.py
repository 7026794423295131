"""What half loops gain and give back is a function of the memory of turning points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezo_rig.chain.given_back import DEEPEST, given_back_each

REACH = 0.7
levels = st.floats(0.0, 10.0).map(lambda v: round(v, 1))


def along(turns, step=0.1):
    """A signal through these levels that stops at every multiple of ``step``."""
    out = [turns[0]]
    for level in turns[1:]:
        count = round(abs(level - out[-1]) / step)
        out += [float(v) for v in np.round(np.linspace(out[-1], level, count + 1)[1:], 1)]
    return np.array(out)


def gains(signal, reach=REACH):
    return given_back_each(np.array([0]), signal, reach)


def expected(moved, whole):
    return REACH * (1.0 - np.exp(-moved / REACH)) * (1.0 - moved / whole)


def test_a_first_rise_gains_nothing_and_both_ways_gain_the_same():
    signal = along([0.0, 8.0, 0.0, 8.0])
    up, down, again = np.split(gains(signal)[1:], 3)
    moved = np.linspace(0.0, 8.0, 81)[1:]
    assert np.all(up == 0.0)
    assert down == pytest.approx(expected(moved, 8.0), abs=1e-12)
    assert again == pytest.approx(expected(moved, 8.0), abs=1e-12)


@given(before=st.lists(levels, min_size=1, max_size=12), loop=st.lists(levels, min_size=1,
       max_size=12))  # fmt: skip
def test_whatever_stays_within_the_last_half_loop_leaves_no_trace(before, loop):
    """A loop between the ends of a half loop, however it wanders, is wiped out by its end."""
    begin = along([0.0, *before, 10.0, 2.0, 10.0, 4.0])
    inside = [float(np.clip(v, 4.2, 9.8)) for v in loop]
    detour = along([4.0, *inside, 4.0, 10.0])
    straight = along([4.0, 10.0])
    there = gains(np.concatenate([begin, detour[1:]]))[-1]
    assert there == pytest.approx(gains(np.concatenate([begin, straight[1:]]))[-1], abs=1e-9)


@given(turns=st.lists(levels, min_size=2, max_size=30))
def test_it_never_leaps(turns):
    signal = along([0.0, *turns])
    change, moved = np.abs(np.diff(gains(signal))), np.abs(np.diff(signal))
    assert np.all(change <= 2.0 * moved + 1e-9)


def test_stretches_do_not_know_each_other():
    signal = along([0.0, 5.0, 1.0, 4.0])
    twice = given_back_each(np.array([0, signal.size]), np.tile(signal, 2), REACH)
    assert np.array_equal(twice, np.tile(gains(signal), 2))


def test_more_loops_inside_each_other_than_are_kept_are_no_fault():
    turns = [0.0]
    for k in range(2 * DEEPEST):
        turns += [10.0 - 0.1 * k, 0.1 + 0.1 * k]
    out = gains(along(turns))
    assert np.all(np.isfinite(out))
    back = gains(along([*turns, 10.0]))[-1]
    assert back == pytest.approx(0.0, abs=1e-9)


@given(turns=st.lists(levels, min_size=2, max_size=30), seed=st.integers(0, 99))
def test_rounding_does_not_decide_whether_a_loop_is_closed(turns, seed):
    signal = along([0.0, 3.0, 0.0, *turns, 0.0, 1.0, 0.0, 1.0])
    rng = np.random.default_rng(seed)
    rounded = signal + 1e-15 * rng.choice([-1.0, 0.0, 1.0], signal.size) * (signal > 0.0)
    assert gains(rounded) == pytest.approx(gains(signal), abs=1e-7)
