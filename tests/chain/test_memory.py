"""Return-point memory, closure and continuity over random turning points."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from small_models import DX, K, lawful, play, ride, table

from piezo_rig.chain import Maxwell, Model

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
