"""Return-point memory, closure and continuity over random turning points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_models import DX, K, lawful, play, ride, table

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Elements, Maxwell, Model

volts = st.floats(-14.0, 14.0).map(lambda v: round(v, 3))
turning = st.lists(volts, min_size=2, max_size=12)


def zigzag(values):
    """Turning points that alternate, from a virgin start at 0 V."""
    out = [0.0]
    for v in values:
        if len(out) > 1 and (v - out[-1]) * (out[-1] - out[-2]) > 0:
            out[-1] = v
        elif v != out[-1]:
            out.append(v)
    return out if len(out) > 1 else [0.0, 1.0]


@settings(max_examples=80, deadline=None)
@given(turning, volts)
def test_a_closed_excursion_leaves_no_trace_when_parameters_are_constant(values, aside):
    turns = zigzag(values)
    # an excursion back from the last point, inside ground that is remembered
    back = turns[-2] + 0.6 * (turns[-1] - turns[-2])
    model = Model((Maxwell.of(table(K)),))
    with_loop = play(model, ride([*turns, back, turns[-1], aside], 9))
    without = play(model, ride([*turns, aside], 9)) if aside != turns[-1] else with_loop
    reached = 9 * (len(turns) - 1)
    assert abs(with_loop[reached] - with_loop[reached + 18]) < 1e-12
    assert abs(with_loop[-1] - without[-1]) < 1e-12


@settings(max_examples=40, deadline=None)
@given(turning, st.sampled_from(["range", "extremum", "direction", "initiation"]))
def test_displacement_never_jumps(values, name):
    drive = ride(zigzag(values), 60)
    y = play(lawful(name), drive)
    # no branch of these models is softer than its last element, or that of the first rise
    assert np.all(np.abs(np.diff(y)) <= np.abs(np.diff(drive)) / 4.0 + 1e-12)


@settings(max_examples=40, deadline=None)
@given(turning)
def test_sampling_makes_no_difference(values):
    # half volts: smaller reversals are noise, and how small depends on the sampling
    turns = zigzag([round(2.0 * v) / 2.0 for v in values])
    model = lawful("range")
    coarse, fine = play(model, ride(turns, 3)), play(model, ride(turns, 30))
    assert np.max(np.abs(coarse - fine[::10])) < 1e-12


def test_a_full_cycle_closes_to_rounding():
    model = Model((Maxwell.of(table(K)),))
    y = play(model, ride([0.0, 14.0] + [-14.0, 14.0] * 50, 50))
    assert abs(y[50] - y[-1]) < 1e-13
    assert DX > 0


def test_what_becomes_of_a_loop_that_is_closed_exactly_shows_where_a_law_holds():
    """Worked out by hand: 10, 8 and 6 V/um up to 0.2 and 1.0 um of a later branch, the first
    10 + 0.05 x range; 0, 40, 34, 40, 20 V."""
    table = Elements.from_slopes(np.array([10.0, 8.0, 6.0]), np.array([0.1, 0.5, 100.0]))
    drive = np.array([0.0, 40.0, 34.0, 40.0, 20.0])
    rise, down, up = 0.5 + 35.8 / 6, 0.2 + 3.6 / 8, 0.2 + 3.94 / 8
    forgotten = 1.0 + (20.0 - 8.46) / 6  # along the branch of a range of 6 V to the end
    kept = up + 2.8 / 8 + (20.0 - 8.8) / 6  # from 34 V on along the one of 40 V
    for ties, last in ((0.0, forgotten), (1.0, kept)):
        law = CAUSES["range-dependence"].of(
            None, slope=0.05, offset=0.0, reach=0.2, closing=0.0, taper=0.0, ties=ties
        )
        said = Model((Maxwell.of(table), law), {}, "").simulate(np.arange(5.0), drive, "virgin")
        assert said == pytest.approx(
            [0.0, rise, rise - down, rise - down + up, rise - down + up - last], abs=1e-12
        )


@settings(max_examples=60, deadline=None)
@given(turning, st.sampled_from(["range", "extremum", "direction", "initiation"]))
def test_a_drive_of_turning_points_alone_ends_where_a_sampled_one_does(values, name):
    """Steps over many bands at once leave the memory that bands one by one leave."""
    turns = zigzag([round(2.0 * v) / 2.0 for v in values])
    model = lawful(name)
    leaps, fine = play(model, ride(turns, 1)), play(model, ride(turns, 30))
    assert np.max(np.abs(leaps - fine[::30])) < 1e-12
