"""Displacement carries its standard uncertainty."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from piezo_rig.cli import main
from piezo_rig.config import load_rig
from piezo_rig.errors import InputError
from piezo_rig.resources import find, shipped_folder
from piezo_rig.run_file.air import per_hpa, per_kelvin, refractive_index
from piezo_rig.run_file.budget import budget_of
from piezo_rig.run_file.sweep import Sweep

RIG = (shipped_folder("configs") / "simulated_bench.toml").read_text()
SENSOR = find("calibration", "sios_sp_s120").read_text()
AIR = """
[environment]
temperature_c = 20.0
temperature_u_k = 0.1
pressure_hpa = 1013.25
pressure_u_hpa = 0.2
dead_path_mm = 100.0
"""


def sweep(sensor_v: np.ndarray, sensitivity: float = 15.48) -> Sweep:
    return Sweep(
        name="sweep_0001", command_v=np.zeros(sensor_v.size), sensor_v=sensor_v, sample_rate=5000.0,
        gain=7.5, offset_v=75.0, sensitivity_um_per_v=sensitivity, polarity=-1,
        zero_v=float(sensor_v[0]), condition="0-75", repeat=1, history="virgin", start_time=0.0,
        origin="SIMULATED",
    )


def texts(rig: str = RIG, sensor: str = SENSOR) -> dict[str, str]:
    return {"rig_config": rig, "calibration_texts": json.dumps({"sensor.toml": sensor})}


def values(budget) -> dict[str, float]:
    return {part.name: part.value for part in budget.parts}


RAMP = np.linspace(0.0, -0.7, 2000)


@pytest.mark.parametrize(("celsius", "humidity", "kpa", "nm", "n"), [
    # NIST Engineering Metrology Toolbox, comparison of equations, modified Edlen
    (20, 0, 101.325, 633, 1.000271799), (20, 0, 60, 633, 1.000160920),
    (20, 0, 120, 633, 1.000321918), (5, 0, 100, 633, 1.000282750),
    (50, 0, 100, 633, 1.000243270), (20, 100, 100, 633, 1.000267394),
    (40, 75, 120, 633, 1.000299406), (50, 100, 120, 633, 1.000287864),
    (20, 0, 101.325, 1700, 1.000268483), (20, 0, 101.325, 300, 1.000286579),
])
def test_the_index_of_air_is_that_of_the_published_table(celsius, humidity, kpa, nm, n):
    assert refractive_index(celsius, 10 * kpa, humidity, 1e-3 * nm) == pytest.approx(n, abs=6e-10)


def test_100_mm_of_dead_path_are_95_nm_per_kelvin_and_27_nm_per_hectopascal():
    assert per_kelvin(20, 1013.25, 50) * 1e8 == pytest.approx(-95.0, abs=1.0)
    assert per_hpa(20, 1013.25, 50) * 1e8 == pytest.approx(27.0, abs=0.5)


def test_a_bench_with_nominal_values_knows_rounding_noise_and_quantisation():
    budget = budget_of(sweep(RAMP), texts())
    found = values(budget)
    assert found["sensitivity"] == pytest.approx(0.005 / 15.48 / math.sqrt(3))
    assert found["noise"] == 2.7
    assert found["analog output"] == pytest.approx(15_480 * 8.8e-5)
    assert found["quantisation"] == pytest.approx(15_480 * 2 / 65_536 / math.sqrt(12))
    assert found["zero"] == pytest.approx(budget.random_nm)
    assert any("calibrate" in text for text in budget.left_out)
    assert any("dead path" in text for text in budget.left_out)


def test_an_analog_output_whose_noise_nobody_stated_is_named_and_not_in_the_sum():
    told = budget_of(sweep(RAMP), texts())
    untold = budget_of(sweep(RAMP), texts(sensor=SENSOR.replace("output_noise_v", "# ")))
    assert not any("analog output" in text for text in told.left_out)
    assert "analog output" not in values(untold)
    assert sum("analog output" in text for text in untold.left_out) == 1
    assert any("analog output" in text for text in budget_of(sweep(RAMP), {}).left_out)


def test_the_rounding_of_a_printed_value_follows_its_decimals():
    rig = RIG.replace("sensitivity = 3 ", "sensitivity = 4 ")
    found = values(budget_of(sweep(RAMP, 61.9), texts(rig)))
    assert found["sensitivity"] == pytest.approx(0.05 / 61.9 / math.sqrt(3))


def test_a_measured_sensitivity_brings_its_own_uncertainty():
    sensor = SENSOR + (
        "[[measured]]\nswitch = 3\nsensitivity_um_per_v = 15.5\nsensitivity_u_um_per_v = 0.031\n")
    budget = budget_of(sweep(RAMP, 15.5), texts(sensor=sensor))
    assert budget.scale == pytest.approx(0.002)
    # 10 um away from zero the scale is 20 nm; the rest adds in squares
    expected = math.sqrt(20.0**2 + budget.offset_nm**2 + budget.random_nm**2)
    assert budget.u_um(np.array([0.0, 10.0]))[1] == pytest.approx(1e-3 * expected)
    assert budget.u_um(np.zeros((2, 3))).shape == (2, 3)
    # a calibration for another sensitivity than the sweep's says nothing of it
    assert budget_of(sweep(RAMP, 15.48), texts(sensor=sensor)).scale == 0.0


def test_the_dead_path_counts_where_the_air_was_logged():
    found = values(budget_of(sweep(RAMP), texts(RIG + AIR)))
    assert found["dead path, temperature"] == pytest.approx(9.5, abs=0.1)
    assert found["dead path, pressure"] == pytest.approx(5.4, abs=0.1)
    half = budget_of(sweep(RAMP), texts(RIG + "[environment]\ndead_path_mm = 100\n"))
    assert not any("dead path" in name for name in values(half))
    assert sum("was logged" in text for text in half.left_out) == 2


def test_a_recording_tells_its_noise_and_its_steps_itself():
    rng = np.random.default_rng(3)
    lsb = 1e-4
    volts = np.round((0.4 * np.sin(np.linspace(0, 6, 20_000)) + rng.normal(0, 3e-4, 20_000)) / lsb)
    budget = budget_of(sweep(volts * lsb, 10.0), {})
    found = values(budget)
    # white noise of 3 nm with the rounding to steps of 1 nm in it
    assert found["noise"] == pytest.approx(math.hypot(3.0, 1 / math.sqrt(12)), rel=0.1)
    assert found["quantisation"] == pytest.approx(1 / math.sqrt(12), rel=1e-6)
    assert budget.scale == 0.0
    assert any("10 um/V" in text for text in budget.left_out)


def test_damaged_texts_are_not_known_rather_than_an_error():
    for bad in ({"rig_config": "=", "calibration_texts": "["},
                {"rig_config": RIG, "calibration_texts": '{"a": 3}'},
                texts(sensor="instrument = 3")):
        assert budget_of(sweep(RAMP), bad).scale == 0.0
    assert budget_of(sweep(np.zeros(2)), {}).random_nm == 0.0


def test_show_prints_the_budget_of_every_sensitivity(tmp_path, capsys):
    table = tmp_path / "r.csv"
    rows = [f"{i / 1000},{-10 + i % 50 / 10},{-0.01 * (i % 50)}" for i in range(300)]
    table.write_text("\n".join(["time_s,command_v,sensor_v", *rows]) + "\n")
    out = tmp_path / "r.h5"
    assert main(["import", str(table), "--sensitivity", "3", "--out", str(out)]) == 0
    assert main(["show", str(out)]) == 0
    said = capsys.readouterr().out
    assert "standard uncertainty of displacement at 15.48 um/V" in said
    assert "together, at 7.59 um" in said


def test_the_air_of_a_rig_is_checked(tmp_path):
    (tmp_path / "rig.toml").write_text(RIG + AIR)
    rig = load_rig(str(tmp_path / "rig.toml"))
    assert rig.environment.dead_path_mm == 100.0
    (tmp_path / "rig.toml").write_text(RIG + "[environment]\npressure_hpa = 101325\n")
    with pytest.raises(InputError, match=r"pressure_hpa: 101325 is above 1400"):
        load_rig(str(tmp_path / "rig.toml"))
