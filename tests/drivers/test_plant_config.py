"""Settings are strict and say where they went wrong; numba waits for a plant."""

import subprocess
import sys
import threading

import numpy as np
import pytest

from drivers.simulated.plant import Plant, PlantConfig, settings

CATALOGUE = [
    "drive-clipping",
    "slew-limit",
    "amplifier-lag",
    "drive-gain",
    "initiation-stage",
    "range-dependence",
    "extremum-dependence",
    "direction-asymmetry",
    "creep",
    "rate-dependence",
    "resonance",
    "cycle-aging",
    "remanence",
    "thermal-drift",
    "periodic-nonlinearity",
    "fringe-jump",
    "sensor-clipping",
    "sensor-scale",
    "mains-hum",
    "outliers",
    "time-skew",
    "clock-ratio",
    "dropped-samples",
]


@pytest.mark.parametrize("cause", CATALOGUE)
def test_every_cause_of_the_catalogue_has_a_switch_under_its_id(cause):
    for state in (True, False):
        config = PlantConfig.from_mapping({cause: {"on": state}})
        assert getattr(config, cause.replace("-", "_")).on is state


@pytest.mark.parametrize(
    ("given", "path"),
    [
        ({"crep": {}}, "crep"),
        ({"creep": {"rate": 1}}, "creep.rate"),
        ({"creep": {"on": 1}}, "creep.on"),
        ({"creep": 0.01}, "creep"),
        ({"creep": {"rate_per_decade": "large"}}, "creep.rate_per_decade"),
        ({"creep": {"rate_per_decade": float("nan")}}, "creep.rate_per_decade"),
        ({"resonance": {"damping": 1.5}}, "resonance.damping"),
        ({"sensor": {"switch": 2.5}}, "sensor.switch"),
        ({"strangers": {"backlash": {"gap": -1}}}, "strangers.backlash.gap"),
        ({"fringe-jump": {"times": 3.0}}, "fringe-jump.times"),
        ({"dropped-samples": {"drops": [[1, 2, 3]]}}, "dropped-samples.drops"),
        ({"sensor": {"polarity": 0}}, "sensor.polarity"),
        ({"recovery": {"hold_off": 30.0}}, "recovery.hold_off"),
    ],
)
def test_a_setting_that_does_not_fit_is_named_by_its_path(given, path):
    with pytest.raises(ValueError, match=rf"^{path.replace('.', '[.]')}"):
        Plant(given)


def test_every_setting_is_listed_with_its_meaning():
    rows = {key: (default, unit, text) for key, default, unit, text in settings()}
    assert rows["amplifier_lag.tau"][1] == "s"
    assert rows["strangers.self_heating.on"][0] is False
    assert all(text for _, _, text in rows.values())


def test_numba_is_not_imported_before_a_plant_is_made():
    code = "import sys, drivers.simulated.plant; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_waveform_must_be_a_row_of_finite_volts():
    plant = Plant()
    for command in (np.zeros((2, 2)), np.zeros(0), np.array([0.0, np.nan])):
        with pytest.raises(ValueError, match="waveform"):
            plant.play(0.0, command, 5000.0)


def test_several_threads_may_ask_at_once():
    plant = Plant()
    plant.set_level(0.0, -10.0)
    plant.play(1.0, np.linspace(-10.0, 0.0, 5000), 5000.0)
    alone = plant.record(1.0, 5000.0, 5000).sensor_v
    seen: list[np.ndarray] = []
    threads = [
        threading.Thread(target=lambda: seen.append(plant.record(1.0, 5000.0, 5000).sensor_v))
        for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(seen) == 4
    assert all(np.array_equal(x, alone) for x in seen)
