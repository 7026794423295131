"""Limits of amplifier and sensor, and clocks that differ, on drives with closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause, Context
from piezo_rig.chain import Elements, Maxwell, Model, Signal

TIME = np.arange(0.0, 1.0, 1e-3)
TRIANGLE = 60.0 * (1.0 - np.abs(1.0 - 2.0 * TIME))  # up and down at 120 V/s
MAXWELL = Maxwell.of(Elements.from_curve(np.linspace(2.0, 60.0, 30), np.linspace(0.1, 0.15, 30)))


def acted(id, drive=TRIANGLE, displacement=TRIANGLE, **values):
    return CAUSES[id].of(None, **values).act(Signal(TIME, drive, displacement))


def test_an_amplifier_that_can_follow_is_not_slowed():
    assert acted("slew-limit", limit=121.0).drive_v == pytest.approx(TRIANGLE)


def test_a_slow_amplifier_meets_its_command_on_the_way_back():
    driven = acted("slew-limit", limit=40.0).drive_v
    # rising at 40 V/s from rest it meets the line that falls at 120 V/s from 60 V at 0.75 s
    assert TIME[np.argmax(driven)] == pytest.approx(0.75, abs=2e-3)
    assert driven.max() == pytest.approx(30.0, abs=0.1)
    assert np.max(np.abs(np.diff(driven))) <= 40.0 * 1e-3 + 1e-12


def test_a_slow_amplifier_meets_its_command_between_two_samples():
    time = 0.1 * np.arange(11)
    drive = 60.0 * (1.0 - np.abs(1.0 - 2.0 * time))
    stage = CAUSES["slew-limit"].of(None, limit=40.0)
    driven = stage.act(Signal(time, drive, drive)).drive_v
    # they meet at 0.75 s and 30 V; from there it falls at 40 V/s
    expected = np.where(time < 0.75, 40.0 * time, 30.0 - 40.0 * (time - 0.75))
    assert driven == pytest.approx(expected, abs=1e-12)
    # where the drive can be followed once it is met, it is
    slow = np.where(time < 0.5, drive, 60.0 - 20.0 * (time - 0.5))
    driven = stage.act(Signal(time, slow, slow)).drive_v
    met = (60.0 + 20.0 * 0.5) / 60.0  # 40 t = 60 - 20 (t - 0.5)
    assert driven == pytest.approx(np.where(time < met, 40.0 * time, slow), abs=1e-12)


def test_behind_a_clipped_drive_the_hysteresis_starts_back_from_the_limit():
    model = Model((MAXWELL,))
    drive = model.with_stage(CAUSES["drive-clipping"].of(None, lower=-1000.0, upper=45.0))
    level = float(model.simulate(TIME, TRIANGLE)[np.searchsorted(TRIANGLE[:500], 45.0)])
    sensor = model.with_stage(CAUSES["sensor-clipping"].of(None, level=level))
    x, y = drive.simulate(TIME, TRIANGLE), sensor.simulate(TIME, TRIANGLE)
    assert x[:500] == pytest.approx(y[:500], abs=0.02)  # rising, one looks like the other
    # back from the top: the clipped drive moves again as soon as it is below 45 V, the hidden
    # motion has its hysteresis behind it and comes out of the limit later
    assert np.flatnonzero(x < x.max() - 0.02)[-1] > 700
    assert np.argmax((x < x.max() - 0.02) & (TIME > 0.6)) < np.argmax(
        (y < y.max() - 0.02) & (TIME > 0.6)
    )


def test_a_clipped_sensor_ends_above_or_below_its_zero():
    x = TRIANGLE - 30.0 + 30.0
    assert acted("sensor-clipping", displacement=x, level=10.0).displacement_um.max() == 10.0
    assert acted("sensor-clipping", displacement=-x, level=-10.0).displacement_um.min() == -10.0


def test_a_fast_digitizer_sees_everything_later_and_later():
    seen = acted("clock-ratio", displacement=5.0 * TIME, ppm=1000.0).displacement_um
    assert seen == pytest.approx(5.0 * TIME / 1.001, abs=1e-12)


@pytest.mark.parametrize("anew", [0.0, 1.0])
def test_a_digitizer_that_is_triggered_anew_begins_in_time_again(anew):
    """Two recordings that carry on from each other, four seconds apart."""
    time = np.concatenate([TIME, TIME + 5.0])
    stage = CAUSES["clock-ratio"].of(None, ppm=1000.0, anew=anew)
    seen = stage.act(Signal(time, 0.0 * time, 5.0 * time)).displacement_um
    late = 5.0 * time - seen
    assert late[: TIME.size] == pytest.approx(5.0 * TIME * (1.0 - 1.0 / 1.001), abs=1e-9)
    since = TIME if anew else TIME + 5.0
    assert late[TIME.size + 5 :] == pytest.approx(
        (5.0 * since * (1.0 - 1.0 / 1.001))[5:], abs=1e-9
    )


def test_samples_far_apart_are_no_pauses_whatever_was_played_before():
    """Twenty samples a second, behind a drive that was played long before: one recording."""
    time = np.concatenate([np.linspace(-1e7, -9e6, 60), 0.05 * np.arange(40)])
    stage = CAUSES["clock-ratio"].of(None, ppm=1000.0, anew=1.0)
    seen = stage.act(Signal(time, 0.0 * time, 5.0 * time)).displacement_um
    assert seen[60:] == pytest.approx(5.0 * time[60:] / 1.001, abs=1e-9)


def test_a_clock_is_looked_for_both_ways_where_recordings_carry_on_after_a_pause():
    data = Context(Model((MAXWELL,)), 8.0, 60.0, np.array([120.0]), 1e-3, 1.0, 1000.0)
    kind = CAUSES["clock-ratio"]
    assert all("anew" not in form.parameters for (form,) in kind.variants(data))
    forms = kind.variants(replace(data, pauses=True))
    assert {form["anew"] for (form,) in forms} == {0.0, 1.0}


@pytest.mark.parametrize("id", ["drive-clipping", "slew-limit", "sensor-clipping", "clock-ratio"])
def test_limits_are_played_and_found_by_examples_that_do_something(id):
    kind = CAUSES[id]
    assert issubclass(kind, Cause)
    assert kind.locked_to == "drive"
    model = Model((MAXWELL,))
    plain = model.simulate(TIME, TRIANGLE)
    context = Context(
        model, float(np.ptp(plain)), 60.0, np.array([120.0]), 1e-3, 1.0, 1000.0,
        ends_v=(0.0, 60.0), ends_um=(0.0, float(plain.max())),
    )  # fmt: skip
    forms = kind.variants(context)
    assert forms
    for (trial,) in forms:
        assert np.any(model.with_stage(trial).simulate(TIME, TRIANGLE) != plain)


@pytest.mark.parametrize("id", ["fringe-jump", "dropped-samples"])
def test_events_are_left_out_of_simulations(id):
    kind = CAUSES[id]
    assert kind.locked_to == "clock"
    stage = kind.of(None, **dict.fromkeys(kind.units, 3.0))
    model = Model((MAXWELL,))
    assert np.array_equal(
        model.with_stage(stage).simulate(TIME, TRIANGLE), model.simulate(TIME, TRIANGLE)
    )


def test_a_limit_that_nothing_reaches_is_not_reported():
    stage = CAUSES["drive-clipping"].of(None, lower=-1000.0, upper=70.0)
    assert isinstance(stage, Cause)
    assert set(stage.reported(np.diag([0.0, 0.01]))) == {"upper"}


def data_of(*slews: float) -> Context:
    return Context(Model((MAXWELL,)), 8.0, 60.0, np.array(slews), 1e-3, 1.0, 1e3)


@pytest.mark.parametrize(("limit", "slews", "plausible"), [
    (249.9, (250.0, 250.0), False),  # a lag of 0.7 ms has been called that
    (200.0, (250.0, 250.0), True), (249.9, (250.0, 60.0), True),
])  # fmt: skip
def test_a_limit_just_below_the_only_speed_is_not_told_from_a_lag(limit, slews, plausible):
    assert CAUSES["slew-limit"].of(None, limit=limit).plausible(data_of(*slews)) == plausible


@pytest.mark.parametrize(("frequency", "plausible"), [(450.0, True), (590.0, False)])
def test_a_mode_with_less_than_two_samples_a_period_is_not_told_from_a_delay(frequency, plausible):
    mode = CAUSES["resonance"].of(None, share=0.3, frequency=frequency, damping=0.1)
    assert mode.plausible(data_of(250.0, 60.0)) == plausible  # a millisecond between samples


@pytest.mark.parametrize(("damping", "plain"), [(0.03, True), (0.2, True), (0.34, False)])
def test_a_mode_that_rings_little_is_much_like_a_lag(damping, plain):
    """Modes of 0.34 to 0.65 lags and delays have been called."""
    mode = CAUSES["resonance"].of(None, share=0.3, frequency=300.0, damping=damping)
    assert mode.plain == plain
    assert CAUSES["resonance"].limits["damping"][1] <= 0.5


@pytest.mark.parametrize("found", [
    ("amplifier-lag", "slew-limit", "drive-clipping"),
    ("drive-clipping", "amplifier-lag", "slew-limit"),
])  # fmt: skip
def test_an_amplifier_clips_then_slews_then_lags_whatever_was_found_first(found):
    """Its rails and its current are within it, the lag is that of its output into the load: a step
    beyond a rail ends as exp(-t / tau) towards the rail, and not at once.
    """
    values = {
        "amplifier-lag": {"tau": 2e-3}, "slew-limit": {"limit": 1e6},
        "drive-clipping": {"lower": -1000.0, "upper": 50.0},
    }  # fmt: skip
    time = np.arange(400) * 1e-4
    drive = np.where(time < 2e-3, 0.0, 100.0)
    model = Model((MAXWELL,))
    for id in found:
        model = model.with_stage(CAUSES[id].of(None, **values[id]))
    assert [s.id for s in model.stages][:3] == ["drive-clipping", "slew-limit", "amplifier-lag"]
    signal = Signal(time, drive, np.zeros(0))
    for stage in model.stages[:3]:
        signal = stage.act(signal)
    late = time >= 2.5e-3
    # the step is a ramp between two samples: half a sample early
    wanted = 50.0 * (1.0 - np.exp(-(time[late] - 1.95e-3) / 2e-3))
    assert signal.drive_v[late] == pytest.approx(wanted, abs=0.3)
