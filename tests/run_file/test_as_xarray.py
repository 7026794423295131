"""`Run.to_xarray`: sweeps of different lengths over one time."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from small_run import RATE, small_run, sweep, sweeps

from piezo_rig.errors import InputError
from piezo_rig.run_file.imported import write_imported
from piezo_rig.run_file.reader import Run


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Run:
    pytest.importorskip("xarray")
    return Run(small_run(tmp_path_factory.mktemp("run")))


def test_every_sweep_that_counts_is_there_with_its_coordinates(run):
    found = run.to_xarray()
    assert found.sizes == {"sweep": 3, "time": 800}
    assert list(found.sweep.values) == ["sweep_0001", "sweep_0002", "sweep_0004"]
    assert list(found.condition.values) == ["0-65", "steps 1/2", "0-65"]
    assert list(found.repeat.values) == [1, 1, 3]
    assert list(found.samples.values) == [500, 600, 800]
    assert list(found.condition_upper_v.values) == [65.0, 40.0, 65.0]
    assert found.time.values == pytest.approx(np.arange(800) / RATE)
    assert found.attrs["origin"] == "IMPORTED"


def test_values_are_those_of_the_run_and_nan_after_the_end(run):
    found = run.to_xarray()
    for sent in (sweeps()[k] for k in (0, 1, 3)):
        row = found.sel(sweep=sent.name)
        assert np.array_equal(row.displacement_um.values[: sent.samples], sent.displacement_um)
        assert np.array_equal(row.sensor_v.values[: sent.samples], sent.sensor_v)
        assert np.isnan(row.drive_v.values[sent.samples :]).all()
    assert np.isnan(found.sel(sweep="sweep_0004").drive_monitor_v).all()  # it has none


def test_everything_has_its_unit(run):
    found = run.to_xarray()
    assert {n: v.attrs["units"] for n, v in found.data_vars.items()} == {
        "drive_v": "V", "displacement_um": "um", "command_v": "V", "sensor_v": "V",
        "drive_monitor_v": "V",
    }
    assert found.time.attrs["units"] == found.start_time.attrs["units"] == "s"


def test_repeats_are_compared_in_one_line(run):
    first = run.to_xarray(["sweep_0001", "sweep_0003"]).isel(time=slice(0, 500))
    apart = first.displacement_um.groupby("condition").std("sweep").sel(condition="0-65")
    expected = np.std([s.displacement_um[:500] for s in (sweeps()[0], sweeps()[2])], axis=0)
    assert apart.values == pytest.approx(expected)


def test_sweeps_of_two_rates_have_no_time_in_common(tmp_path):
    pytest.importorskip("xarray")
    other = sweep(2, "0-65", 2, 65.0, sample_rate=1000.0)
    run = Run(write_imported([sweep(1, "0-65", 1, 65.0), other], tmp_path / "two.h5", []))
    with pytest.raises(InputError, match="sampled at 1000, 2000 samples/s"):
        run.to_xarray()
    assert run.to_xarray(["sweep_0002"]).time.values[1] == pytest.approx(1e-3)


def test_a_missing_xarray_is_said_with_what_brings_it(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(InputError) as error:
        run.to_xarray()
    assert error.value.code == "extra-missing"
    assert "piezo-rig[xarray]" in error.value.remedy
