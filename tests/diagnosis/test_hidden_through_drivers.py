"""An effect hidden in the simulated bench's plant, played through the drivers, found from the run.

The plant shares no code with the program. What it does by default is switched off but for the
noise, so that nothing is in a run beyond a Prandtl-Ishlinskii body, the sensor's noise and what a
test hides. The samples go over sockets and a pseudo terminal; `diagnose` gets the run, no more.
"""

from __future__ import annotations

import json

import pytest

from piezo_rig.cli import main
from piezo_rig.resources import shipped_folder

PROTOCOL = """
schema = "piezo-rig/protocol/1"
name = "hidden"
sample_rate = 2000
repeats = 2
history = "virgin"
[[condition]]
waveform = "triangle"
lower_v = 0
upper_v = [30, 50, 75]
frequency_hz = 2
cycles = 3
[[condition]]
waveform = "triangle"
lower_v = 25
upper_v = 75
start = "upper"
frequency_hz = 2
cycles = 3
"""
ON_BY_DEFAULT = (
    "amplifier_lag", "initiation_stage", "range_dependence", "direction_asymmetry", "creep",
    "resonance",
)  # fmt: skip
RIG = (shipped_folder("configs") / "simulated_bench.toml").read_text()


@pytest.fixture
def diagnosed(tmp_path, capsys):
    """A function: what is hidden in the plant, as {table: settings} -> the diagnosis JSON.

    Without the drive monitor, unless a test asks for it.
    """

    def play_and_diagnose(hidden, seed=1, monitor=0):
        tables = dict.fromkeys(ON_BY_DEFAULT, "on = false")
        tables |= {name: f"on = true\n{settings}" for name, settings in hidden.items()}
        plant = "".join(f"\n[plant.{name}]\n{text}\n" for name, text in tables.items())
        rig = RIG.replace("monitor_channel = 1", f"monitor_channel = {monitor}")
        (tmp_path / "rig.toml").write_text(f"{rig}seed = {seed}\n{plant}")
        (tmp_path / "hidden.toml").write_text(PROTOCOL)
        runs, out = tmp_path / "runs", tmp_path / "found.json"
        assert main(["run", str(tmp_path / "hidden.toml"), "--rig", str(tmp_path / "rig.toml"),
                     "--out", str(runs)]) == 0  # fmt: skip
        (run,) = runs.glob("*.h5")
        assert main(["diagnose", str(run), "--json", str(out)]) == 0, capsys.readouterr().err
        return json.loads(out.read_text())

    return play_and_diagnose


def first(found, cause):
    """The first finding, which is the cause or cannot be told from it."""
    assert found["findings"], "nothing was found"
    finding = found["findings"][0]
    assert cause in [finding["cause"], *finding["alternatives"]]
    assert not found["unexplained"]["detected"]
    return finding


def holds(parameter, true):
    """Whether the interval, widened by half, holds the true value.

    Widened because one honest interval of 95 % in twenty misses; half as wide again, one in 300.
    """
    low, high = parameter["ci95"]
    return abs(true - 0.5 * (low + high)) <= 1.5 * 0.5 * (high - low)


def test_nothing_hidden_is_nothing_found(diagnosed):
    found = diagnosed({})
    assert found["findings"] == []
    assert not found["unexplained"]["detected"]
    assert found["follow_up"] is None


def test_creep(diagnosed):
    finding = first(diagnosed({"creep": "rate_per_decade = 0.01"}), "creep")
    assert finding["gain_percent"] > 0
    assert finding["gain_ci95"][0] > 0
    assert finding["cause"] == "creep"
    assert holds(finding["parameters"]["rate_per_decade"], 0.01)


@pytest.mark.study
@pytest.mark.parametrize("seed", [1])
def test_a_sensor_that_lags(diagnosed, seed):
    finding = first(diagnosed({"time_skew": "delay = 5e-4"}, seed), "time-skew")
    assert finding["gain_percent"] > 0
    assert finding["gain_ci95"][0] > 0
    # under triangles of one frequency an amplifier's lag looks nearly the same, and is as long
    size = {"time-skew": "delay", "amplifier-lag": "tau"}
    if finding["cause"] in size:
        assert holds(finding["parameters"][size[finding["cause"]]], 5e-4)


@pytest.mark.study
def test_drift(diagnosed):
    finding = first(diagnosed({"thermal_drift": "rate = 10.0"}), "thermal-drift")
    assert finding["cause"] == "thermal-drift"
    assert holds(finding["parameters"]["rate"], 10.0)


@pytest.mark.study
def test_hum(diagnosed):
    # 25 periods a cycle, and 1575.03 from sweep to sweep: the
    # hum is nearly the same in all sweeps, at a harmonic of the drive
    frequency = 50.0
    settings = f"frequency = {frequency}\namplitude = 4.0"
    finding = first(diagnosed({"mains_hum": settings}), "mains-hum")
    assert finding["cause"] == "mains-hum"
    assert holds(finding["parameters"]["frequency"], frequency)
    assert holds(finding["parameters"]["amplitude"], 4.0)


@pytest.mark.study
def test_the_interferometers_ripple(diagnosed):
    found = diagnosed({"periodic_nonlinearity": "amplitude = 3.0"})
    finding = first(found, "periodic-nonlinearity")
    assert finding["gain_percent"] > 0
    assert finding["gain_ci95"][0] > 0
    assert holds(finding["parameters"]["amplitude"], 3.0)


@pytest.mark.study
def test_spikes(diagnosed):
    finding = first(diagnosed({"outliers": "per_second = 2.0\nheight = 300.0"}), "outliers")
    assert finding["cause"] == "outliers"
    assert finding["gain_percent"] is None  # nothing foretells them
    assert holds(finding["parameters"]["per_second"], 2.0)


@pytest.mark.study
def test_a_first_rise_of_its_own(diagnosed):
    finding = first(diagnosed({"initiation_stage": "size = -0.3"}), "initiation-stage")
    assert finding["gain_percent"] > 0
    assert finding["gain_ci95"][0] > 0


@pytest.mark.study
def test_a_stranger_is_called_unexplained(diagnosed):
    found = diagnosed({"strangers.stiction_bump": "size = 0.03"})
    assert found["unexplained"]["detected"]
    assert found["unexplained"]["rms_nm"] > found["unexplained"]["allowance_nm"]
    assert "displacement" in found["unexplained"]["pattern"]["depends_on"]
