"""What the interferometer adds, each effect at its stated size."""

import numpy as np
import pytest

from drivers.simulated.plant import Plant

RATE = 5000.0
OFF = {name: {"on": False} for name in ("white_noise", "one_over_f_noise", "quantisation")}


def at_rest(config, count=50_000, t=100.0, rate=RATE, seed=None):
    """Measured displacement in nm of an actuator that has nothing to do."""
    plant = Plant(config, seed=seed)
    plant.set_level(0.0, -10.0)
    return -15.48e3 * plant.record(t, rate, count).sensor_v


def ramp(config, count=50_000):
    """Measured and true displacement in um of a slow ramp to 75 V."""
    drive = np.linspace(0.0, 75.0, count)
    out = []
    for c in (config, OFF):
        plant = Plant(c)
        plant.set_level(0.0, -10.0)
        plant.play(100.0, (drive - 75.0) / 7.5, RATE)
        out.append(-15.48 * plant.record(100.0, RATE, count).sensor_v)
    return out


def test_volts_fall_as_the_stack_grows_by_the_printed_sensitivity():
    for switch, scale in ((2, 3.87), (3, 15.48), (4, 61.9)):
        plant = Plant({**OFF, "sensor": {"switch": switch, "zero_v": 0.5}})
        plant.set_level(0.0, -10.0)
        plant.set_level(50.0, -5.0)
        um = plant.displacement_um(51.0)
        assert plant.sensor_v(51.0) == pytest.approx(0.5 - um / scale)


def test_the_output_ends_at_10_v():
    plant = Plant({**OFF, "sensor": {"switch": 1}})
    assert plant.sensor_v(0.0) == -10.0


def test_white_noise_has_its_rms_and_a_flat_spectrum():
    config = {**OFF, "white_noise": {"on": True, "rms": 2.0}}
    x = at_rest(config)
    assert x.std() == pytest.approx(2.0, rel=0.03)
    power = np.abs(np.fft.rfft(x)[1:]) ** 2
    low, high = power[:5000].mean(), power[-5000:].mean()
    assert low / high == pytest.approx(1.0, abs=0.12)


def test_one_over_f_noise_falls_by_ten_per_decade_and_has_its_rms_over_a_sweep():
    config = {**OFF, "one_over_f_noise": {"on": True, "rms": 2.0}}
    x = np.array([at_rest(config, 25_000, seed=seed) for seed in range(1, 41)])
    assert np.sqrt(x.var(axis=1).mean()) == pytest.approx(2.0, rel=0.15)
    x -= x.mean(axis=1, keepdims=True)
    power = (np.abs(np.fft.rfft(x * np.hanning(x.shape[1]))) ** 2).mean(axis=0)
    f = np.fft.rfftfreq(x.shape[1], 1.0 / RATE)
    band = (f > 2.0) & (f < 500.0)
    slope = np.polyfit(np.log(f[band]), np.log(power[band]), 1, w=1.0 / np.sqrt(f[band]))[0]
    assert slope == pytest.approx(-1.0, abs=0.1)


def test_autoregressive_noise_has_its_coefficient():
    x = at_rest({**OFF, "ar-noise": {"on": True, "rms": 5.0, "coefficient": 0.95}}, 200_000)
    assert x.std() == pytest.approx(5.0, rel=0.1)
    assert np.corrcoef(x[1:], x[:-1])[0, 1] == pytest.approx(0.95, abs=0.01)


def test_noise_belongs_to_the_instant_and_the_seed():
    noisy = {"ar-noise": {"on": True}, "outliers": {"on": True, "per_second": 50.0}}
    plant = Plant(noisy, seed=7)
    whole = plant.record(3.0, RATE, 3000).sensor_v
    pieces = [plant.record(3.0 + k / RATE, RATE, 1000).sensor_v for k in (0, 1000, 2000)]
    np.testing.assert_array_equal(np.concatenate(pieces), whole)
    again = Plant(noisy, seed=7).record(3.0, RATE, 3000).sensor_v
    np.testing.assert_array_equal(again, whole)
    other = Plant(noisy, seed=8).record(3.0, RATE, 3000).sensor_v
    assert not np.array_equal(other, whole)


def test_slow_noise_is_the_same_at_any_rate():
    config = {**OFF, "one_over_f_noise": {"on": True}}
    fine, coarse = at_rest(config, 5000, rate=50_000.0), at_rest(config, 500, rate=5_000.0)
    np.testing.assert_allclose(fine[::10], coarse, atol=1e-6)


def test_the_converter_has_sixteen_bits():
    x = at_rest({**OFF, "white_noise": {"on": True}, "quantisation": {"on": True}})
    steps = np.diff(np.unique(np.round(x, 6)))
    assert steps.min() == pytest.approx(20.0 / 65536 * 15.48e3, rel=1e-3)


def test_drift_runs_with_the_clock():
    x = at_rest({**OFF, "thermal-drift": {"on": True, "rate": 3.0}})
    assert (x[-1] - x[0]) / ((x.size - 1) / RATE) == pytest.approx(3.0, rel=1e-6)


def test_a_random_walk_spreads_with_the_root_of_time():
    config = {**OFF, "thermal-drift": {"on": True, "rate": 0.0, "walk": 2.0}}
    gone = [np.diff(at_rest(config, 2, rate=0.01, seed=seed))[0] for seed in range(300)]
    assert np.std(gone) == pytest.approx(20.0, rel=0.2)


def test_the_periodic_error_repeats_every_half_wave():
    error = {"on": True, "amplitude": 5.0, "second_harmonic": 0.2, "phase": 0.3}
    seen, true = ramp({**OFF, "periodic-nonlinearity": error})
    angle = 2.0 * np.pi * true / 0.3164 + 0.3
    expected = 5.0 * (np.sin(angle) + 0.2 * np.sin(2.0 * angle))
    np.testing.assert_allclose(1e3 * (seen - true), expected, atol=1e-6)


def test_fringe_jumps_are_multiples_of_79_nm_at_their_times():
    jumps = {"on": True, "times": [101.0, 103.0], "multiples": [1, -3]}
    x = at_rest({**OFF, "fringe-jump": jumps})
    np.testing.assert_allclose(x[[4999, 5000, 14_999, 15_000]], [0, 79.1, 79.1, -158.2], atol=1e-3)


def test_random_jumps_come_at_their_rate():
    x = at_rest({**OFF, "fringe-jump": {"on": True, "per_second": 0.5}}, 40_000, rate=100.0)
    steps = np.diff(x)[np.abs(np.diff(x)) > 1.0]
    assert steps.size == pytest.approx(200, abs=60)
    np.testing.assert_allclose(np.abs(steps), 79.1, atol=1e-3)


def test_the_analogue_output_saturates_at_its_level():
    seen, true = ramp({**OFF, "sensor-clipping": {"on": True, "level": 6.0}})
    np.testing.assert_allclose(seen, np.minimum(true, 6.0), atol=1e-9)


def test_a_wrong_scale_shows_less_where_the_sensitivity_is_larger():
    seen, true = ramp({**OFF, "sensor-scale": {"on": True, "ratio": 1.01}})
    np.testing.assert_allclose(1.01 * seen, true, atol=1e-9)


def test_hum_has_its_line_and_odd_harmonics():
    hum = {"on": True, "frequency": 60.0, "amplitude": 4.0, "third": 0.5, "fifth": 0.0}
    x = at_rest({**OFF, "mains-hum": hum})
    lines = 2.0 * np.abs(np.fft.rfft(x)) / x.size
    f = np.fft.rfftfreq(x.size, 1.0 / RATE)
    assert lines[f == 60.0] == pytest.approx(4.0, rel=1e-3)
    assert lines[f == 180.0] == pytest.approx(2.0, rel=1e-3)
    assert lines[f == 300.0] == pytest.approx(0.0, abs=1e-3)


def test_outliers_come_at_their_rate_and_height():
    x = at_rest({**OFF, "outliers": {"on": True, "per_second": 20.0, "height": 100.0}})
    spikes = np.abs(x[np.abs(x) > 1.0])
    assert spikes.size == pytest.approx(200, abs=60)
    assert spikes.min() >= 50.0 - 1e-3
    assert spikes.max() <= 150.0 + 1e-3


def test_a_skewed_channel_shows_the_past_and_leaves_the_drive_alone():
    drive = np.linspace(0.0, 75.0, 2500)
    plants = [Plant(OFF), Plant({**OFF, "time-skew": {"on": True, "delay": 0.002}})]
    for plant in plants:
        plant.set_level(0.0, -10.0)
        plant.play(100.0, (drive - 75.0) / 7.5, RATE)
    prompt, late = (plant.record(100.0, RATE, 2500) for plant in plants)
    np.testing.assert_allclose(late.sensor_v[10:], prompt.sensor_v[:-10], atol=1e-9)
    np.testing.assert_allclose(late.stack_v, prompt.stack_v, atol=1e-9)
