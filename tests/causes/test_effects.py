"""Each cause does what its physics says, on drives with closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize
import scipy.signal

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause, Context
from piezo_rig.chain import Elements, Maxwell, Model, Signal

TIME = np.arange(0.0, 20.0, 1e-3)


def seen(id, displacement, drive=None, time=TIME, **values):
    stage = CAUSES[id].of(None, **values)
    drive = np.zeros(time.size) if drive is None else drive
    return stage.act(Signal(time, drive, displacement)).displacement_um


def test_creep_adds_the_same_amount_in_every_decade():
    step = np.where(TIME > 0, 1.0, 0.0)
    x = seen("creep", step, rate_per_decade=0.01)
    at = [x[np.searchsorted(TIME, t)] for t in (0.1, 1.0, 10.0)]
    assert np.diff(at) == pytest.approx([0.01, 0.01], rel=0.1)


def test_an_amplifier_behind_its_command_is_late_by_tau_on_a_ramp():
    signal = Signal(TIME, 30.0 * TIME, np.zeros(TIME.size))
    out = CAUSES["amplifier-lag"].of(None, tau=2e-3).act(signal).drive_v
    assert out[-1] == pytest.approx(30.0 * (TIME[-1] - 2e-3), rel=1e-9)


def test_a_skewed_record_shows_what_was_there_a_delay_ago():
    x = seen("time-skew", 5.0 * TIME, delay=1.5e-3)
    assert x[100:] == pytest.approx(5.0 * (TIME[100:] - 1.5e-3), abs=1e-12)


def widened(drive, compliance, thresholds, weights, wider):
    """A spring and play operators whose thresholds all grow by ``wider`` (n,), sample by sample."""
    out, state = np.empty(drive.size), np.zeros(thresholds.size)
    for i, v in enumerate(drive):
        r = thresholds + wider[i]
        state = np.minimum(np.maximum(state, v - r), v + r)
        out[i] = compliance * v + weights @ state
    return out


def test_thresholds_that_widen_with_speed_are_those_of_the_operators_themselves():
    time = np.arange(0.0, 1.0, 1e-3)
    drive = np.interp(time, [0.0, 0.3, 0.5, 0.6, 1.0], [0.0, 60.0, 10.0, 50.0, 0.0])
    knots, c = np.array([4.0, 12.0, 30.0, 80.0]), np.array([0.08, 0.1, 0.12, 0.15])
    model = Model((Maxwell.of(Elements.from_curve(knots, c)),))
    lag, exponent, window = 0.05, 0.7, 2e-3
    stage = CAUSES["rate-dependence"].of(
        None, lag_um=lag, exponent=exponent, window_s=window, widens=1.0
    )
    slow = drive.copy()
    decay = np.exp(-1e-3 / window)
    for i in range(1, drive.size):
        fall = (drive[i] - drive[i - 1]) / 1e-3 * window
        slow[i] = drive[i] - fall + (slow[i - 1] - drive[i - 1] + fall) * decay
    # volts that make the lag at the mean compliance of what slides: 0.1 and 0.12 um/V on the
    # later branches' 16 and 36 V
    volts = lag / ((0.1 * 16.0 + 0.12 * 36.0) / 52.0)
    wider = volts * np.abs((drive - slow) / window / 300.0) ** exponent
    own = widened(drive, c[0], knots[:-1], np.diff(c), wider)
    assert model.with_stage(stage).simulate(time, drive) == pytest.approx(own, abs=1e-9)
    assert np.max(np.abs(own - model.simulate(time, drive))) > 0.01


def test_thresholds_that_widen_by_a_share_of_themselves_are_those_operators():
    time = np.arange(0.0, 1.0, 1e-3)
    drive = np.interp(time, [0.0, 0.3, 0.5, 0.6, 1.0], [0.0, 60.0, 10.0, 50.0, 0.0])
    knots, c = np.array([4.0, 12.0, 30.0, 80.0]), np.array([0.08, 0.1, 0.12, 0.15])
    model = Model((Maxwell.of(Elements.from_curve(knots, c)),))
    lag, exponent, window, opens = 0.05, 0.7, 2e-3, 1.6
    stage = CAUSES["rate-dependence"].of(
        None, lag_um=lag, exponent=exponent, window_s=window, widens=2.0, opens_um=opens
    )
    slow = drive.copy()
    decay = np.exp(-1e-3 / window)
    for i in range(1, drive.size):
        fall = (drive[i] - drive[i - 1]) / 1e-3 * window
        slow[i] = drive[i] - fall + (slow[i - 1] - drive[i - 1] + fall) * decay
    rate = (drive - slow) / window / 300.0
    share = lag / opens * np.abs(rate) ** exponent
    state, own = np.zeros(3), np.empty(drive.size)
    for i, v in enumerate(drive):
        if rate[i] * rate[i - 1] < 0.0:  # it stood still in between
            slope = (v - drive[i - 1]) / 1e-3 / 300.0
            # slope + (rate - slope) exp(-t / window) is 0
            at = drive[i - 1] + 300.0 * slope * window * np.log((slope - rate[i - 1]) / slope)
            state = np.clip(state, at - knots[:-1], at + knots[:-1])
        r = knots[:-1] * (1.0 + share[i])
        state = np.clip(state, v - r, v + r)
        own[i] = c[0] * v + np.diff(c) @ state
    assert model.with_stage(stage).simulate(time, drive) == pytest.approx(own, abs=1e-9)
    assert np.max(np.abs(own - model.simulate(time, drive))) > 0.01


def test_thresholds_that_widen_by_a_given_compliance_do_not_hang_on_the_elements():
    time = np.arange(0.0, 1.0, 1e-3)
    drive = np.interp(time, [0.0, 0.3, 0.5, 0.6, 1.0], [0.0, 60.0, 10.0, 50.0, 0.0])
    knots, c = np.array([4.0, 12.0, 30.0, 80.0]), np.array([0.08, 0.1, 0.12, 0.15])
    stage = CAUSES["rate-dependence"].of(
        None, lag_um=0.05, exponent=0.7, window_s=2e-3, widens=1.0, um_per_v=0.1
    )

    def moved(compliance):
        elements = Elements.from_curve(knots, compliance)
        return Model((Maxwell.of(elements),)).with_stage(stage).simulate(time, drive)

    both = moved(c) + moved(c[::-1].cumsum())  # linear in what the elements are
    assert both == pytest.approx(moved(c + c[::-1].cumsum()), abs=1e-9)


def test_viscosity_lags_by_its_length_at_300_volts_per_second():
    for slope in (300.0, -300.0):
        x = seen("rate-dependence", np.zeros(TIME.size), drive=slope * TIME,
                 lag_um=0.05, exponent=0.6)  # fmt: skip
        assert x[-1] == pytest.approx(-np.sign(slope) * 0.05, rel=1e-6)


@pytest.mark.parametrize("exponent", [0.3, 0.7, 0.95])
def test_a_lag_that_levels_off_has_its_length_and_exponent_at_300_volts_per_second(exponent):
    lag = {}
    for slope in (297.0, 300.0, 303.0, 0.3, 0.6, 3e6, 3e7, 3e8):
        x = seen("rate-dependence", np.zeros(TIME.size), drive=slope * TIME,
                 lag_um=0.05, exponent=exponent, levels_off=1.0)  # fmt: skip
        lag[slope] = -x[-1]
    assert lag[300.0] == pytest.approx(0.05, rel=1e-9)
    grows = np.log(lag[303.0] / lag[297.0]) / np.log(303.0 / 297.0)
    assert grows == pytest.approx(exponent, abs=1e-4)
    assert lag[0.6] == pytest.approx(2.0 * lag[0.3], rel=0.05)  # as the speed, where it is slow
    assert lag[3e8] - lag[3e7] == pytest.approx(lag[3e7] - lag[3e6], rel=1e-2)  # as its logarithm


def test_a_lag_that_settles_does_so_within_its_time():
    rate = np.where(TIME < 0.05, 300.0, -75.0)
    drive = np.concatenate([[0.0], np.cumsum(rate[:-1] * np.diff(TIME))])
    x = seen("rate-dependence", np.zeros(TIME.size), drive=drive, lag_um=0.05, exponent=0.5,
             window_s=8e-3, settles=1.0)  # fmt: skip
    turn = TIME[np.searchsorted(TIME, 0.05)]
    up = 0.05 * (1.0 - np.exp(-TIME / 8e-3))
    late = TIME - turn
    down = -0.025 + (up[np.searchsorted(TIME, turn)] + 0.025) * np.exp(-late / 8e-3)
    assert x == pytest.approx(-np.where(late <= 0.0, up, down), abs=1e-9)


def test_the_periodic_error_repeats_every_half_wave():
    x = np.linspace(0.0, 0.9492, TIME.size)
    error = seen("periodic-nonlinearity", x, sine=3.0, cosine=0.0, sine_2=0.0, cosine_2=0.0) - x
    assert np.max(error) == pytest.approx(3e-3, rel=1e-3)
    third = TIME.size // 3
    assert error[:third] == pytest.approx(error[third : 2 * third], abs=2e-5)


def test_drift_goes_with_the_clock_and_is_left_out_of_simulations():
    assert seen("thermal-drift", np.zeros(TIME.size), rate=10.0)[-1] == pytest.approx(
        0.01 * TIME[-1]
    )
    table = Elements.from_curve(np.array([1.0, 2.0]), np.array([0.1, 0.12]))
    model = Model((Maxwell.of(table), CAUSES["thermal-drift"].of(None, rate=10.0)))
    assert np.all(model.simulate(TIME, np.zeros(TIME.size)) == 0.0)


def test_a_mode_answers_a_corner_as_the_equation_of_motion_does():
    time = np.arange(0.0, 0.05, 1e-4)
    ramp = 40.0 * np.maximum(time - 0.01, 0.0)
    omega, damping = 2 * np.pi * 600.0, 0.04
    system = ([omega**2], [1.0, 2 * damping * omega, omega**2])
    x = seen("resonance", ramp, time=time, share=0.3, frequency=600.0, damping=damping)
    (_, moved, _) = scipy.signal.lsim(system, ramp, time)
    assert x == pytest.approx(0.7 * ramp + 0.3 * moved, abs=1e-9)


def test_a_mode_whose_damper_moves_along_is_not_late_on_a_ramp():
    time = np.arange(0.0, 0.05, 1e-4)
    ramp = 40.0 * np.maximum(time - 0.01, 0.0)
    omega, damping = 2 * np.pi * 600.0, 0.04
    system = ([2 * damping * omega, omega**2], [1.0, 2 * damping * omega, omega**2])
    x = seen("resonance", ramp, time=time, share=0.3, frequency=600.0, damping=damping,
             moves_along=1.0)  # fmt: skip
    (_, moved, _) = scipy.signal.lsim(system, ramp, time)
    assert x == pytest.approx(0.7 * ramp + 0.3 * moved, abs=1e-9)
    assert x[-1] == pytest.approx(ramp[-1], abs=1e-4)


def test_a_mode_does_not_mind_how_a_record_is_sampled():
    time = np.cumsum(np.random.default_rng(5).choice([1e-4, 2e-4, 5e-4], 300))
    even = np.arange(0.0, time[-1] + 1e-4, 1e-5)
    ramp = 40.0 * np.minimum(time, time[150])
    fine = 40.0 * np.minimum(even, time[150])
    values = {"share": 1.0, "frequency": 600.0, "damping": 0.2}
    coarse = seen("resonance", ramp - ramp[0], time=time, **values)
    # the finer record begins at 0 s, in motion; both have forgotten that after 100 ms
    close = np.interp(time, even, seen("resonance", fine, time=even, **values)) - ramp[0]
    late = time > time[0] + 0.02
    assert coarse[late] == pytest.approx(close[late], abs=2e-5)


@pytest.mark.parametrize(("frequency", "damping", "rate"), [
    (225.0, 0.039, 1000.0), (123.0, 0.042, 1000.0), (620.0, 0.02, 5000.0),
])  # fmt: skip
def test_where_a_generator_holds_its_samples_a_mode_rings_in_its_interval(frequency, damping, rate):
    # the staircase of a generator through the mode, by the matrix exponential, and what a drive
    # that is straight between samples would have done, fitted to it
    corner, n = 30, 30 + int(rate * 4.0 / (damping * 2.0 * np.pi * frequency))
    ramp = np.maximum(np.arange(n) - corner, 0.0) / rate

    def mode(hz, of_critical, held):
        omega = 2.0 * np.pi * hz
        system = ([omega**2], [1.0, 2.0 * of_critical * omega, omega**2])
        matrices = scipy.signal.tf2ss(*system)
        a, b, c, d, _ = scipy.signal.cont2discrete(matrices, 1.0 / rate, held)
        return scipy.signal.dlsim((a, b, c, d, 1.0 / rate), ramp)[1][:, 0]

    seen = mode(frequency, damping, "zoh")[corner:]

    def off(x):
        straight = mode(frequency * x[0], damping * x[1], "foh")[corner:]
        columns = np.stack([straight, ramp[corner:], np.ones(n - corner)], axis=1)
        return seen - columns @ np.linalg.lstsq(columns, seen, rcond=None)[0]

    fitted = frequency * scipy.optimize.least_squares(off, [1.0, 1.0]).x[0]
    sd = CAUSES["resonance"].of(
        None, share=0.1, frequency=frequency, damping=damping
    ).between_samples(1.0 / rate)["frequency"]
    assert 0.3 * 1.96 * sd < abs(fitted - frequency) < 1.96 * sd


def test_every_example_of_a_cause_changes_what_it_should_and_little():
    drive = np.tile(np.concatenate([np.linspace(0, 50, 500), np.linspace(50, 0, 500)]), 3)
    time = np.arange(drive.size) * 1e-3
    knots = np.arange(1.0, 11.0) * 5.0
    model = Model((Maxwell.of(Elements.from_curve(knots, np.linspace(0.1, 0.16, 10))),))
    plain = model.simulate(time, drive)
    context = Context(model, float(np.ptp(plain)), 50.0, np.array([100.0]), 1e-3, 3.0, 1000.0)
    for id, kind in CAUSES.items():
        assert issubclass(kind, Cause)
        for trial in kind.trials(context):
            if trial.locked_to == "clock":
                continue
            earlier = (np.array([0.0, 75.0, 0.0]),)
            change = model.with_stage(trial).simulate(time, drive, earlier=earlier) - plain
            assert 0.0 < np.max(np.abs(change)) < 0.05 * context.travel_um, id


def test_creep_carries_many_small_changes_as_it_carries_one():
    rng = np.random.default_rng(3)
    time = np.cumsum(rng.uniform(1e-3, 5e-3, 400))
    base = np.cumsum(rng.standard_normal(400))
    changes = np.cumsum(rng.standard_normal((3, 400)), axis=1)
    stage = CAUSES["creep"].of(None, rate_per_decade=0.02)
    carried = stage.carry(Signal(time, base, base), changes)
    for change, found in zip(changes, carried, strict=True):
        alone = stage.act(Signal(time, base, change)).displacement_um
        assert found - found[0] == pytest.approx(alone - alone[0], abs=1e-10)


def asymmetric(drive, **values):
    knots, c = np.array([4.0, 12.0, 30.0, 80.0]), np.array([0.08, 0.1, 0.12, 0.15])
    stage = CAUSES["direction-asymmetry"].of(None, closing=1.0, **values)
    model = Model((Maxwell.of(Elements.from_curve(knots, c)),)).with_stage(stage)
    return model.simulate(np.arange(drive.size) / 5e3, drive)


@pytest.mark.parametrize("taper", [0.0, 1.0, 2.0, 3.0])
def test_an_asymmetric_actuator_closes_loops_of_every_size(taper):
    # down and up again from within a first rise, then up and down again from within a fall
    for size in (0.05, 0.6, 3.0, 12.0):
        loop = np.concatenate([np.linspace(0.0, -size, 30), np.linspace(-size, 0.0, 30)[1:]])
        rise, fall = np.linspace(0.0, 60.0, 200), np.linspace(60.0, 30.0, 100)
        drive = np.concatenate([rise, *(60.0 + loop[1:],) * 3, fall[1:], *(30.0 - loop[1:],) * 3])
        x = asymmetric(drive, ratio=0.9, reach=0.4, taper=taper)
        assert x[199 + 58 * np.arange(4)] == pytest.approx(x[199], abs=1e-12)
        assert x[-1 - 58 * np.arange(4)] == pytest.approx(x[-1], abs=1e-12)


@pytest.mark.parametrize("taper", [0.0, 1.0, 2.0, 3.0])
def test_half_loops_of_an_asymmetric_actuator_begin_in_the_ratio_and_end_alike(taper):
    up, down = np.linspace(0.0, 60.0, 6001), np.linspace(60.0, 0.0, 6001)
    x = asymmetric(np.concatenate([up, down[1:], up[1:]]), ratio=0.9, reach=0.4, taper=taper)
    falling, rising = x[6000:12001], x[12000:]
    # slopes V/um, ascending over descending: what one drive step moves, the other way round
    ratio = (falling[1] - falling[0]) / (rising[0] - rising[1])
    assert ratio == pytest.approx(0.9, rel=1e-3)
    assert rising[-1] - rising[0] == pytest.approx(falling[0] - falling[-1], abs=1e-12)


@pytest.mark.parametrize("widens", [0.0, 1.0])
def test_a_drag_and_widening_thresholds_are_tried_for_each_other(widens):
    stage = CAUSES["rate-dependence"].of(
        None, lag_um=2e-3, exponent=1.4, window_s=1.3e-2, widens=widens, settles=0.0
    )
    forms = [f for f in stage.otherwise() if f["widens"] != widens]
    assert forms
    # what one form made up for says nothing of the other: that begins where rates usually are
    assert all(f["exponent"] == 0.7 and f["window_s"] < 5e-3 for f in forms)
