"""`import` through the command line: the same run file, and nothing guessed in silence."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

from piezo_rig.cli import main
from piezo_rig.run_file.reader import Run


@pytest.fixture
def recording(tmp_path):
    drive = 3.6 * (0.5 - 0.5 * np.cos(2 * np.pi * np.arange(400) / 200))
    rows = np.column_stack([np.arange(400) / 200, drive, 13.0 * drive - 120.0])
    path = tmp_path / "sine.csv"
    np.savetxt(path, rows, delimiter=",", header="time_s,drive_v,displacement_um", comments="")
    return path, rows


def test_drive_and_displacement_are_taken_as_they_are(recording, tmp_path, capsys):
    path, rows = recording
    out = tmp_path / "run.h5"
    assert main(["import", str(path), "--out", str(out)]) == 0
    assert f"run: {out}" in capsys.readouterr().out
    (sweep,) = Run(out).sweeps()
    np.testing.assert_allclose(sweep.drive_v, rows[:, 1], atol=1e-12)
    np.testing.assert_allclose(sweep.displacement_um, rows[:, 2], atol=1e-9)
    assert (sweep.origin, sweep.history, sweep.sample_rate) == ("IMPORTED", "unknown", 200.0)
    assert main(["verify", str(out)]) == 0
    assert main(["show", str(out), "--log"]) == 0
    with h5py.File(out) as f:
        assert "displacement" in f["entry/loop"]


def test_assumptions_are_printed_and_stored(recording, tmp_path, capsys):
    path, _ = recording
    out = tmp_path / "run.h5"
    main(["import", str(path), "--out", str(out)])
    said = [line.removeprefix("assumed: ") for line in capsys.readouterr().out.splitlines()
            if line.startswith("assumed: ")]
    assert said
    assert Run(out).texts["notes"].splitlines() == said


def test_sensor_volts_without_a_sensitivity_are_refused(tmp_path, capsys):
    path = tmp_path / "volts.csv"
    path.write_text("time_s,command_v,sensor_v\n0,-10,0\n0.1,-9,-0.1\n0.2,-8,-0.2\n0.3,-9,-0.1\n")
    out = tmp_path / "run.h5"
    assert main(["import", str(path), "--out", str(out)]) == 2
    assert capsys.readouterr().err.startswith("error[")
    assert not out.exists()
    assert main(["import", str(path), "--out", str(out), "--sensitivity", "1um/V"]) == 0
    (sweep,) = Run(out).sweeps()
    np.testing.assert_allclose(sweep.drive_v, [0, 7.5, 15, 7.5], atol=1e-12)
    np.testing.assert_allclose(sweep.displacement_um, [0, 0.1, 0.2, 0.1], atol=1e-12)


def test_gain_offset_and_polarity_can_be_said(tmp_path):
    path = tmp_path / "volts.csv"
    path.write_text("time_s,command_v,sensor_v\n0,0,5\n0.1,1,6\n0.2,2,7\n0.3,1,6\n")
    out = tmp_path / "run.h5"
    words = ["--sensitivity", "0", "--gain", "10", "--offset", "-1", "--polarity", "+1"]
    assert main(["import", str(path), "--out", str(out), *words]) == 0
    (sweep,) = Run(out).sweeps()
    np.testing.assert_allclose(sweep.drive_v, [-1, 9, 19, 9], atol=1e-12)
    np.testing.assert_allclose(sweep.displacement_um, [0, 0.24, 0.48, 0.24], atol=1e-12)


def test_an_existing_run_is_not_overwritten(recording, tmp_path, capsys):
    path, _ = recording
    out = tmp_path / "run.h5"
    out.write_bytes(b"precious")
    assert main(["import", str(path), "--out", str(out)]) == 4
    assert out.read_bytes() == b"precious"
    assert capsys.readouterr().err.startswith("error[disk]")
