"""What was played before, in this recording and in the one before it, on closed forms."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause, Context
from piezo_rig.causes.cycle_aging import cycles
from piezo_rig.causes.remanence import turns_to
from piezo_rig.chain import Elements, Maxwell, Model, Signal

HALF = np.linspace(0.0, 50.0, 101)
CYCLE = np.concatenate([HALF[1:], HALF[-2::-1]])
TEN = np.concatenate([[0.0], np.tile(CYCLE, 10)])
TIME = np.arange(TEN.size) * 5e-3


def aged(x, drive=TEN, time=TIME, **values):
    stage = CAUSES["cycle-aging"].of(None, **values)
    return stage.act(Signal(time, drive, x)).displacement_um


def test_the_count_grows_by_one_half_with_every_half_loop():
    assert cycles(TEN)[[0, 50, 150, 250]] == pytest.approx([0.0, 0.25, 0.75, 1.25])


@pytest.mark.parametrize("whole", [0.0, 1.0])
def test_the_tenth_cycle_travels_a_decade_further_than_the_first(whole):
    x = aged(0.1 * TEN, rate_per_decade=0.02, whole=whole)
    tops = x[100::200]
    numbers = np.arange(1, 11)
    assert tops == pytest.approx(5.0 * (1.0 + 0.02 * np.log10(numbers)), rel=1e-6)
    assert x[200::200] == pytest.approx(np.zeros(10), abs=1e-9)


def test_the_stroke_grows_and_the_place_where_a_rise_begins_stays():
    drive = np.concatenate([np.linspace(0.0, 75.0, 51), np.tile(
        np.concatenate([np.linspace(75.0, 25.0, 51)[1:], np.linspace(25.0, 75.0, 51)[1:]]), 4
    )])  # fmt: skip
    time = np.arange(drive.size) * 1e-2
    x = aged(0.1 * drive, drive, time, rate_per_decade=0.05)
    assert x[100::100] == pytest.approx(np.full(4, 2.5), abs=1e-9)
    assert x[50::100] == pytest.approx(2.5 + 5.0 * (1 + 0.05 * np.log10(np.arange(1, 6))))


def test_what_is_played_long_before_a_recording_is_not_counted():
    knots = np.arange(1.0, 11.0) * 5.0
    plain = Model((Maxwell.of(Elements.from_curve(knots, np.linspace(0.1, 0.16, 10))),))
    model = plain.with_stage(CAUSES["cycle-aging"].of(None, rate_per_decade=0.02))
    first = slice(0, 201)
    change = model.simulate(TIME, TEN, "unknown") - plain.simulate(TIME, TEN, "unknown")
    assert change[first] == pytest.approx(np.zeros(201), abs=1e-12)
    assert change[1900] == pytest.approx(0.02 * np.ptp(plain.simulate(TIME, TEN, "unknown")))


def test_a_hold_is_no_cycle():
    drive = np.concatenate([HALF, np.full(500, 50.0), HALF[::-1][1:]])
    time = np.arange(drive.size) * 5e-3
    assert np.array_equal(aged(0.1 * drive, drive, time, rate_per_decade=0.1), 0.1 * drive)


def test_ageing_carries_small_changes_as_it_carries_all():
    rng = np.random.default_rng(3)
    changes = np.cumsum(rng.standard_normal((3, TEN.size)), axis=1)
    for whole in (0.0, 1.0):
        stage = CAUSES["cycle-aging"].of(None, rate_per_decade=0.02, whole=whole)
        carried = stage.carry(Signal(TIME, TEN, 0.1 * TEN), changes)
        for change, found in zip(changes, carried, strict=True):
            alone = stage.act(Signal(TIME, TEN, change)).displacement_um
            assert found == pytest.approx(alone, abs=1e-12)


@pytest.mark.parametrize("whole", [0.0, 1.0])
def test_a_session_counts_on_and_a_mean_is_that_of_its_recordings(whole):
    stage = CAUSES["cycle-aging"].of(None, rate_per_decade=0.02, whole=whole, session=1.0)
    before = (np.array([9.0, 99.0]),)
    x = stage.act(Signal(TIME, TEN, 0.1 * TEN, played=before)).displacement_um
    decades = [0.5 * (np.log10(n + 9.0) + np.log10(n + 99.0)) for n in range(1, 11)]
    assert x[100::200] == pytest.approx(5.0 * (1.0 + 0.02 * np.array(decades)))
    anew = stage.with_values(session=0.0)
    assert np.array_equal(
        anew.act(Signal(TIME, TEN, 0.1 * TEN, played=before)).displacement_um,
        anew.act(Signal(TIME, TEN, 0.1 * TEN)).displacement_um,
    )


def test_a_cycle_may_have_its_number_at_its_beginning():
    x = aged(0.1 * TEN, rate_per_decade=0.02, whole=1.0, begins_at=1.0)
    numbers = np.arange(1, 11) + 0.5
    assert x[100::200] == pytest.approx(5.0 * (1.0 + 0.02 * np.log10(numbers)))


@pytest.mark.parametrize(("before", "forms"), [(0.0, 5), (12.0, 8)])
def test_ageing_is_looked_for_in_all_of_its_forms(before, forms):
    kind = CAUSES["cycle-aging"]
    assert issubclass(kind, Cause)
    model = Model((Maxwell.of(Elements.from_curve(np.array([60.0]), np.array([0.1]))),))
    plain = model.simulate(TIME, TEN)
    context = Context(
        model, 5.0, 50.0, np.array([100.0]), 5e-3, 10.0, 200.0, cycles_before=before
    )
    changes = [
        model.with_stage(t).simulate(TIME, TEN, played=np.array([before])) - plain
        for (t,) in kind.variants(context)
    ]
    assert len(changes) == forms
    assert not any(np.allclose(a, b) for a, b in pairwise(changes))
    assert all(0.0 < np.max(np.abs(c)) < 0.05 for c in changes)


def played(thresholds, drive, begin):
    """Play operators by hand."""
    state = begin.copy()
    for v in drive:
        state = np.minimum(np.maximum(state, v - thresholds), v + thresholds)
    return state


def test_turning_points_leave_any_memory_that_is_less_steep_than_a_drives():
    r = 40.0 * np.linspace(1.0, 0.0, 801)
    left = 0.3 * np.minimum(r, 40.0 - r)
    thresholds = np.linspace(0.13, 39.9, 57)
    found = played(thresholds, turns_to(r, left), np.zeros(57))
    wanted = 0.3 * np.minimum(thresholds, 40.0 - thresholds)
    assert found == pytest.approx(wanted, abs=0.25 * 0.05 + 1e-9)
    assert np.mean(found - wanted) == pytest.approx(0.0, abs=2e-3)


BIG = np.array([0.0, 60.0, 0.0])


def remembering(fraction, turns=(BIG,)):
    """One element that gives way at 20 V and doubles the slope, after a rise to 60 V."""
    model = Model((Maxwell.of(Elements.from_curve(np.array([20.0, 100.0]), np.array([0.1, 0.2]))),))
    rise = np.linspace(0.0, 60.0, 241)
    stage = CAUSES["remanence"].of(None, fraction=fraction)
    x = model.with_stage(stage).simulate(0.01 * np.arange(241), rise, earlier=turns)
    return rise, x


@pytest.mark.parametrize("fraction", [0.0, 0.25, 0.6])
def test_an_element_that_remembers_gives_way_later_by_what_it_remembers(fraction):
    rise, x = remembering(fraction)
    # at the end of the recording before it stood 20 V off: play of 20 V after 60 V and back
    way = 20.0 + fraction * 20.0
    wanted = 0.1 * rise + 0.1 * np.maximum(rise - way, 0.0)
    assert x == pytest.approx(wanted, abs=0.1 * 0.03)


def test_what_is_left_shrinks_with_every_rest():
    _, x = remembering(0.5, (BIG, np.array([0.0, 1.0, 0.0])))
    assert x[-1] == pytest.approx(6.0 + 0.1 * (40.0 - 0.25 * 20.0), abs=0.003)


def test_without_a_recording_before_there_is_nothing_to_remember():
    assert np.array_equal(remembering(0.5, ())[1], remembering(0.0)[1])


@pytest.mark.parametrize("fraction", [1e-6, 0.25])
def test_a_first_rise_of_its_own_adds_what_it_is_steeper_by_wherever_memory_stands(fraction):
    """Up, back a little, and on: the first way to every drive counts, and no other."""
    table = Elements.from_curve(np.array([20.0, 100.0]), np.array([0.1, 0.2]))
    risen = Elements.from_curve(np.array([30.0, 100.0]), np.array([0.16, 0.26]))
    plain = Model((Maxwell.of(table), CAUSES["remanence"].of(None, fraction=fraction)))
    model = plain.with_stage(CAUSES["initiation-stage"].of(risen))
    drive = np.concatenate([np.linspace(0.0, 45.0, 91), np.linspace(45.0, 5.0, 81)[1:],
                            np.linspace(5.0, 60.0, 111)[1:]])  # fmt: skip
    time = 0.01 * np.arange(drive.size)
    more = model.simulate(time, drive, earlier=(BIG,)) - plain.simulate(time, drive, earlier=(BIG,))
    m = np.maximum.accumulate(drive)
    own = 0.16 * np.minimum(m, 30.0) + 0.26 * np.maximum(m - 30.0, 0.0)
    of_loops = 0.1 * np.minimum(m, 20.0) + 0.2 * np.maximum(m - 20.0, 0.0)
    assert more == pytest.approx(own - of_loops, abs=1e-9)


def test_a_first_rise_of_its_own_from_no_memory_is_that_of_a_virgin():
    table = Elements.from_curve(np.array([20.0, 100.0]), np.array([0.1, 0.2]))
    risen = Elements.from_curve(np.array([30.0, 100.0]), np.array([0.16, 0.26]))
    virgin = Model((Maxwell.of(table), CAUSES["initiation-stage"].of(risen)))
    turns = [0.0, 30.0, 12.0, 50.0, -55.0, 10.0, 70.0]
    drive = np.concatenate([[0.0], *(np.linspace(a, b, 41)[1:] for a, b in pairwise(turns))])
    time = 0.01 * np.arange(drive.size)
    left = CAUSES["remanence"].of(None, fraction=1e-9)
    x = virgin.with_stage(left).simulate(time, drive, earlier=(BIG,))
    # what stands for the memory that is left are teeth of 60 V / 400, up and down
    assert x == pytest.approx(virgin.simulate(time, drive), abs=0.1 * 0.2)


@pytest.mark.parametrize(("settles", "whole"), [(3.7, 0.0), (1.9, 0.0), (3.7, 1.0)])
def test_ageing_may_be_over_after_some_cycles(settles, whole):
    """By the tenth cycle it has grown by the rate, whatever its law."""
    x = aged(0.1 * TEN, rate_per_decade=0.02, whole=whole, settles=settles)
    n = np.arange(1, 11)
    done = (1.0 - np.exp(-(n - 1) / settles)) / (1.0 - np.exp(-9.0 / settles))
    assert x[100::200] == pytest.approx(5.0 * (1.0 + 0.02 * done), rel=1e-6)


def test_what_has_settled_in_a_session_does_not_go_on():
    stage = CAUSES["cycle-aging"].of(None, rate_per_decade=0.02, session=1.0, settles=3.0)
    late = stage.act(Signal(TIME, TEN, 0.1 * TEN, played=(np.array([500.0]),))).displacement_um
    assert late[100::200] == pytest.approx(np.full(10, 5.0 * (1.0 + 0.02 / -np.expm1(-3.0))))
