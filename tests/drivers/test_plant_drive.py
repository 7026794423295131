"""The plant's electrical side, its laziness and its own record of the stack."""

import io
import math

import numpy as np
import pytest

from drivers.simulated.plant import Plant
from drivers.simulated.plant.history import csv_sink

EXACT = {"amplifier_lag": {"on": False}}


def test_a_generator_that_is_off_puts_75_v_on_the_stack():
    plant = Plant()
    assert plant.stack_v(0.0) == 75.0
    plant.set_level(1.0, -10.0)
    assert plant.stack_v(2.0) == pytest.approx(0.0, abs=1e-9)


def test_the_set_voltage_is_the_offset_even_while_a_waveform_plays():
    plant = Plant(EXACT)
    plant.play(1.0, np.full(5000, -4.0), 5000.0)
    plant.set_amplifier_offset(1.5, 60.0)
    assert plant.stack_v(1.4) == 45.0
    assert plant.stack_v(1.6) == 30.0


def test_without_lag_a_sample_sees_the_value_set_at_its_own_instant():
    command = np.linspace(-10.0, 0.0, 5000)
    plant = Plant(EXACT)
    plant.play(3.3, command, 5000.0)
    record = plant.record(3.3, 5000.0, 5000)
    np.testing.assert_allclose(record.stack_v, 7.5 * command + 75.0, atol=1e-12)
    assert plant.stack_v(5.0) == 0.0, "a burst rests at the waveform's first point"


@pytest.mark.parametrize("rate", [50_000.0, 1_000.0])
def test_a_record_at_another_rate_holds_each_sample_of_the_generator(rate):
    command = -10.0 + 5.0 * (1.0 - np.cos(np.linspace(0.0, 2.0 * np.pi, 2500)))
    plant = Plant(EXACT)
    plant.play(0.7, command, 5000.0)
    record = plant.record(0.7, rate, int(0.5 * rate))
    held = command[(np.arange(int(0.5 * rate)) * 5000 // int(rate))]
    np.testing.assert_allclose(record.stack_v, 7.5 * held + 75.0, atol=1e-12)


def test_the_lag_answers_a_step_with_its_exponential():
    tau = 1e-3
    plant = Plant({"amplifier_lag": {"tau": tau}})
    plant.set_level(0.5, -10.0)
    plant.set_level(1.0, -2.0)
    t = np.arange(100) / 20_000.0
    expected = 60.0 * (1.0 - np.exp(-t / tau))
    np.testing.assert_allclose(plant.record(1.0, 20_000.0, 100).stack_v, expected, atol=1e-9)


def test_the_slew_limit_turns_a_step_into_a_ramp_and_a_tail():
    tau, limit = 1e-3, 300.0
    plant = Plant({"amplifier_lag": {"tau": tau}, "slew-limit": {"on": True, "limit": limit}})
    plant.set_level(0.0, -10.0)
    plant.set_level(1.0, -6.0)
    knee = 30.0 / limit - tau
    t = np.arange(3000) / 20_000.0
    tail = 30.0 - limit * tau * np.exp(-(t - knee) / tau)
    expected = np.where(t < knee, limit * t, tail)
    np.testing.assert_allclose(plant.record(1.0, 20_000.0, 3000).stack_v, expected, atol=1e-8)


def test_clipping_and_gain_error_have_their_stated_size():
    config = {
        **EXACT,
        "drive-clipping": {"on": True, "lower": 2.0, "upper": 50.0},
        "drive-gain": {"on": True, "ratio": 1.1},
    }
    plant = Plant(config)
    for t, command, drive in ((1.0, -10.0, 2.0), (2.0, 0.0, 50.0), (3.0, -6.0, 33.0)):
        plant.set_level(t, command)
        assert plant.stack_v(t) == pytest.approx(drive)


def test_a_gain_error_of_the_command_alone_pivots_at_the_set_voltage():
    plant = Plant({**EXACT, "drive-gain": {"on": True, "ratio": 1.02, "pivot": 75.0}})
    plant.set_level(1.0, -10.0)
    assert plant.stack_v(1.0) == pytest.approx(75.0 - 1.02 * 75.0)


def test_events_in_the_past_are_refused_but_answers_are_not():
    plant = Plant()
    plant.set_level(1.0, -10.0)
    plant.set_level(5.0, -5.0)
    assert plant.stack_v(20.0) == pytest.approx(37.5)
    assert plant.stack_v(2.0) == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(ValueError, match="backwards"):
        plant.set_level(4.0, 0.0)


def test_an_event_at_an_instant_already_looked_at_still_counts():
    asked, unasked = Plant(), Plant()
    for plant in (asked, unasked):
        plant.set_level(1.0, -10.0)
        if plant is asked:
            plant.record(1.0, 5000.0, 20_000)
        plant.set_level(2.0, -5.0)
    np.testing.assert_array_equal(
        asked.record(1.5, 5000.0, 5000).sensor_v, unasked.record(1.5, 5000.0, 5000).sensor_v
    )


def test_hours_of_rest_pass_at_once():
    plant = Plant()
    plant.set_level(1.0, -10.0)
    assert abs(plant.displacement_um(100_000.0)) < 1e-9


def history_of(plant, play):
    rows: list[tuple[float, float]] = []
    plant.keep_history(lambda t, v: rows.extend(zip(t.tolist(), v.tolist(), strict=True)))
    play(plant)
    return np.array(rows).T


def test_the_history_draws_every_ramp_with_its_slew():
    up = np.linspace(-10.0, 0.0, 1251)
    ramp = np.concatenate([up, up[::-1]])

    def play(plant):
        plant.set_level(1.0, -10.0)
        plant.play(30.0, ramp, 5000.0)
        plant.flush_history(60.0)

    t, v = history_of(Plant(EXACT), play)
    assert np.all(np.diff(t) > 0.0)
    assert t[-1] == pytest.approx(60.0)
    inside = (t > 30.001) & (t < 30.25)
    slew = np.diff(v[inside]) / np.diff(t[inside])
    np.testing.assert_allclose(slew, 300.0, rtol=0.25)
    assert np.interp(30.125, t, v) == pytest.approx(37.5, abs=0.1)
    assert t.size < 800, "constant stretches cost two rows"


def test_the_history_shows_a_jump_and_a_glitch_of_a_tenth_of_a_millisecond():
    def play(plant):
        plant.set_level(1.0, -10.0)
        plant.set_level(10.0, 0.0)
        plant.set_level(10.0001, -10.0)
        plant.flush_history(20.0)

    t, v = history_of(Plant(EXACT), play)
    assert v[(t > 5.0)].max() == 75.0
    assert np.interp(9.9, t, v) == pytest.approx(0.0, abs=1e-9)


def test_the_history_is_written_as_rows_of_time_and_voltage():
    file = io.StringIO()
    plant = Plant()
    plant.keep_history(csv_sink(file))
    plant.set_level(1.0, -10.0)
    plant.flush_history(2.0)
    lines = file.getvalue().splitlines()
    assert lines[0] == "time_s,stack_v"
    first, last = (list(map(float, row.split(","))) for row in (lines[1], lines[-1]))
    assert first[1] == 75.0
    assert last == [2.0, 0.0]


def test_the_clock_of_the_digitizer_may_run_fast():
    command = np.linspace(-10.0, 0.0, 50_000)
    config = {**EXACT, "clock-ratio": {"on": True, "ppm": 1000.0}}
    plant = Plant(config)
    plant.play(1.0, command, 5000.0)
    record = plant.record(1.0, 5000.0, 50_000)
    late = math.floor(40_000 / 1.001)
    assert record.stack_v[40_000] == pytest.approx(7.5 * command[late] + 75.0, abs=1e-9)


def test_dropped_samples_shift_what_follows_in_both_channels():
    command = np.linspace(-10.0, 0.0, 1000)
    drops = {"dropped-samples": {"on": True, "drops": [[300, 4], [700, 2]]}}
    whole, torn = Plant(), Plant(drops)
    for plant in (whole, torn):
        plant.play(1.0, command, 5000.0)
    a, b = whole.record(1.0, 5000.0, 1000), torn.record(1.0, 5000.0, 900)
    np.testing.assert_allclose(b.stack_v[:300], a.stack_v[:300])
    np.testing.assert_allclose(b.stack_v[300:700], a.stack_v[304:704])
    np.testing.assert_allclose(b.stack_v[700:], a.stack_v[706:906])


def test_random_losses_come_at_their_rate():
    config = {**EXACT, "dropped-samples": {"on": True, "per_second": 50.0}}
    plant = Plant(config)
    plant.play(1.0, np.linspace(-10.0, 0.0, 100_000), 5000.0)
    v = plant.record(1.0, 5000.0, 50_000).stack_v
    lost = round((v[-1] - v[0]) / (75.0 / 99_999)) - 49_999
    assert lost == pytest.approx(500, abs=5 * math.sqrt(500))
