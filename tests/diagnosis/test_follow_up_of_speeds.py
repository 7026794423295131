"""Range and speed go together at one frequency; what is played next has to take them apart.

The causes are put in by hand: what a ladder finds is not the point here, and takes its time.
"""

from __future__ import annotations

import importlib

import numpy as np
import pytest
from small_bench import recordings

from piezo_rig.causes import CAUSES, named_model
from piezo_rig.chain.half_loops import half_loops
from piezo_rig.diagnosis import engine
from piezo_rig.diagnosis.confusion import confusion
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.refit import refit, settle
from piezo_rig.identification import prepare

follow_up = importlib.import_module("piezo_rig.diagnosis.follow_up")
MATRIX = tuple((f"0-{top}", 0.0, float(top)) for top in (15, 30, 45, 60, 75))
SPEEDS = tuple(
    (f"0-{top} at {hz}", 0.0, float(top), hz) for top in (20, 50) for hz in (0.5, 10.0, 25.0)
)
RANGE, RATES = "range-dependence", "rate-dependence"
STARTS = {
    RANGE: {"slope": 1e-3, "offset": 0.0, "reach": 0.5, "closing": 0.0, "taper": 1.0},
    RATES: {"lag_um": 4e-3, "exponent": 0.6, "window_s": 2e-3, "widens": 0.0},
}
FREE = {RANGE: "slope", RATES: "lag_um"}


def lags(size_um):
    """Behind by so much at 300 V/s, and by the speed to the power 0.6."""

    def effect(x, drive, t):
        rate = np.gradient(drive, t)
        return x - size_um * np.sign(rate) * np.abs(rate / 300.0) ** 0.6

    return effect


def lacks(size_um):
    """Every half loop lacks some of its beginning, in proportion to the range before it."""

    def effect(x, drive, t):
        out, lost = x.copy(), 0.0
        loops = half_loops(drive)
        for k in range(1, len(loops)):
            here = slice(loops.start[k], loops.stop[k] + 1)
            way = 1.0 - np.exp(-np.abs(drive[here] - loops.extremum_v[k]) / 4.0)
            gone = -loops.direction[k] * size_um * loops.range_v[k] / 75.0 * way
            out[here] = x[here] + lost + gone
            lost += gone[-1]
        return out

    return effect


def found(cause, effect, conditions):
    """The right model refitted to recordings with an effect, and what it is confused with."""
    sweeps = recordings(effect, conditions=conditions)
    groups = group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)
    base = Point(starting_model(groups, named_model("classical"), "classical"))
    plain = refit(engine.plain_space(groups, base.model), base)
    whitener, _ = engine.noise_of(groups, plain.point, np.random.default_rng(0))
    space, _ = engine.space_of(groups, whitener, plain.point.model)
    stage = CAUSES[cause].of(None, **STARTS[cause])
    free = FREE[cause]
    size = (cause, free, 0.05 * STARTS[cause][free])
    fitted = refit(space, Point(plain.point.model.with_stage(stage), (), (size,)), held=True)
    settle(space, fitted.point)
    return space, fitted, confusion(space, fitted, cause)


@pytest.mark.study
@pytest.mark.parametrize(("cause", "other", "effect"), [
    (RANGE, RATES, lacks(0.0015)), (RATES, RANGE, lags(0.004)),
])
def test_other_speeds_take_range_and_rate_apart(cause, other, effect, monkeypatch):
    space, fitted, before = found(cause, effect, MATRIX)
    assert other in before.alternatives
    monkeypatch.setattr(follow_up, "shipped_names", lambda kind: ["hold_steps", "rate_sweep"])
    advice = follow_up.follow_up(space, fitted, {cause: [other]})
    assert advice.protocol == "rate_sweep"  # in the other one the actuator recovers on the way
    assert advice.separates == [cause, other]
    _, _, after = found(cause, effect, MATRIX + SPEEDS)
    assert other not in after.alternatives


def test_a_rest_counts_from_the_first_motion_on():
    rate = 100.0
    begin, rise, rest = np.zeros(500), np.linspace(1.0, 30.0, 50), np.zeros(300)
    drive = np.concatenate([begin, rise, rest, rise, np.full(400, 30.0), np.zeros(20)])
    assert follow_up.rest_s(drive, rate) == 3.0
    assert follow_up.rest_s(np.concatenate([begin, rise]), rate) == 0.0
