"""`piezo-rig export` of a run, and the way back."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from small_run import small_run, sweep, sweeps

from piezo_rig.cli import main
from piezo_rig.run_file.imported import write_imported
from piezo_rig.run_file.reader import Run

SAME = ("condition", "repeat", "history", "sample_rate", "gain", "offset_v",
        "sensitivity_um_per_v", "polarity", "zero_v")


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    return small_run(tmp_path_factory.mktemp("run"))


def exported(run, format, out):
    assert main(["export", "--format", format, str(run), "--out", str(out)]) == 0
    return sorted(out.iterdir()) if out.is_dir() else [out]


def back(files, tmp_path):
    assert main(["import", *map(str, files), "--out", str(tmp_path / "back.h5")]) == 0
    return Run(tmp_path / "back.h5").sweeps()


@pytest.mark.parametrize("format", ["csv", "tdms", "mat"])
def test_a_run_comes_back_as_it_was(run, format, tmp_path, capsys):
    files = exported(run, format, tmp_path / ("out.mat" if format == "mat" else "out"))
    assert "left out: sweep_0003: superseded by sweep_0004" in capsys.readouterr().out
    assert len(files) == (1 if format == "mat" else 3)
    expected = [s for s in sweeps() if s.name != "sweep_0003"]
    for sent, found in zip(expected, back(files, tmp_path), strict=True):
        assert {k: getattr(found, k) for k in SAME} == {k: getattr(sent, k) for k in SAME}
        assert found.start_time == pytest.approx(sent.start_time, abs=1e-9)
        assert np.array_equal(found.command_v, sent.command_v)
        assert np.array_equal(found.sensor_v, sent.sensor_v)
        assert np.array_equal(found.displacement_um, sent.displacement_um)
        assert (found.drive_monitor_v is None) == (sent.drive_monitor_v is None)
        assert sent.details.items() <= found.details.items()
        assert found.origin == "IMPORTED"


@pytest.mark.parametrize("format", ["csv", "tdms", "mat"])
def test_what_the_user_says_counts_more_than_what_the_file_states(run, format, tmp_path):
    first = exported(run, format, tmp_path / ("out.mat" if format == "mat" else "out"))[0]
    said = ["--gain", "8", "--offset", "70", "--polarity=+1", "--sensitivity", "2",
            "--history", "unknown"]
    assert main(["import", str(first), *said, "--out", str(tmp_path / "said.h5")]) == 0
    found = Run(tmp_path / "said.h5").sweeps()[0]
    assert (found.gain, found.offset_v, found.polarity) == (8.0, 70.0, 1)
    assert (found.sensitivity_um_per_v, found.history) == (3.87, "unknown")


def test_a_carried_history_without_the_sweep_before_is_unknown(run, tmp_path, capsys):
    files = exported(run, "csv", tmp_path / "out")
    (alone,) = back(files[1:2], tmp_path)
    assert alone.history == "unknown"
    assert "carries the history of sweep_0001, which was not given" in capsys.readouterr().out


def test_a_csv_has_the_columns_of_the_contract_in_volts(run, tmp_path):
    first = exported(run, "csv", tmp_path / "out")[0]
    lines = first.read_text().splitlines()
    stated = [line for line in lines if line.startswith("#")]
    assert lines[len(stated)] == "time_s,command_v,sensor_v,drive_monitor_v"
    assert {"# gain = 7.5", "# sensitivity_um_per_v = 3.87", '# condition = "0-65"'} <= {*stated}
    table = np.loadtxt(first, delimiter=",", skiprows=len(stated) + 1)
    assert np.array_equal(table[:, 2], sweeps()[0].sensor_v)
    assert table[1, 0] - table[0, 0] == pytest.approx(1 / 2000.0)


def test_a_tdms_is_a_waveform_to_labview(run, tmp_path):
    from nptdms import TdmsFile

    first = exported(run, "tdms", tmp_path / "out")[0]
    channel = TdmsFile.read(first)["sweep"]["sensor_v"]
    assert channel.properties["unit_string"] == "V"
    assert channel.properties["wf_increment"] == pytest.approx(1 / 2000.0)
    assert channel.time_track()[3] == pytest.approx(3 / 2000.0)
    assert isinstance(channel.properties["wf_start_time"], np.datetime64)


def test_a_mat_holds_every_sweep_with_volts_and_physics(run, tmp_path):
    from scipy.io import loadmat

    (path,) = exported(run, "mat", tmp_path / "run.mat")
    found = loadmat(path, squeeze_me=True, struct_as_record=False)
    assert found["run"].origin == "IMPORTED"
    assert [s.condition for s in found["sweeps"]] == ["0-65", "steps 1/2", "0-65"]
    for sent, kept in zip([sweeps()[k] for k in (0, 1, 3)], found["sweeps"], strict=True):
        assert np.array_equal(kept.sensor_v, sent.sensor_v)
        assert np.array_equal(kept.displacement_um, sent.displacement_um)
        assert np.array_equal(kept.drive_v, sent.drive_v)
        assert kept.sensitivity_um_per_v == sent.sensitivity_um_per_v
    assert found["sweeps"][2].drive_monitor_v.size == 0


@pytest.mark.parametrize("format", ["csv", "tdms", "mat"])
def test_samples_that_are_not_even_keep_their_times(format, tmp_path):
    even = sweep(1, "0-65", 1, 65.0)
    times = even.time_s**1.5 + even.time_s
    run = write_imported([even.with_(sample_times_s=times)], tmp_path / "uneven.h5", [])
    (found,) = back(exported(run, format, tmp_path / f"one.{format}"), tmp_path)
    assert found.time_s == pytest.approx(times, abs=1e-12)


def test_several_sweeps_do_not_go_into_one_csv(run, tmp_path, capsys):
    assert main(["export", "--format", "csv", str(run), "--out", str(tmp_path / "a.csv")]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error[export-many]:")
    assert "name a folder: --out a" in said


def test_a_mat_of_another_program_is_no_recording(tmp_path, capsys):
    from scipy.io import savemat

    savemat(tmp_path / "other.mat", {"sweeps": np.arange(3.0), "x": 1.0})
    assert main(["import", str(tmp_path / "other.mat"), "--out", str(tmp_path / "x.h5")]) == 2
    assert capsys.readouterr().err.startswith("error[import-mat]:")


@pytest.mark.parametrize(("line", "wrong"), [
    ("# gain = 7.5", "# gain = NaN"), ("# gain = 7.5", "# gain = 0"), ("# gain = 7.5", "#"),
    ("# repeat = 1", "# repeat = true"), ("# repeat = 1", "# repeat = [1"),
    ("# polarity = -1", "# polarity = 3"), ('# history = "virgin"', '# history = "old"'),
])  # fmt: skip
def test_settings_that_were_altered_are_refused_in_words(run, line, wrong, tmp_path, capsys):
    first = exported(run, "csv", tmp_path / "out")[0]
    first.write_text(first.read_text().replace(line, wrong))
    assert main(["import", str(first), "--out", str(tmp_path / "x.h5")]) == 2
    assert capsys.readouterr().err.startswith("error[import-settings]:")


def test_an_empty_run_and_a_full_folder_are_named(tmp_path, run, capsys):
    empty = write_imported([], tmp_path / "empty.h5", [])
    assert main(["export", "--format", "csv", str(empty), "--out", str(tmp_path / "o")]) == 2
    assert "no sweep to be exported" in capsys.readouterr().err
    (tmp_path / "file").write_text("")
    there = tmp_path / "file" / "out"
    assert main(["export", "--format", "csv", str(run), "--out", str(there)]) == 4
    assert capsys.readouterr().err.startswith("error[disk]:")


@pytest.mark.parametrize(("of", "format"), [("run", "c"), ("model", "tdms")])
def test_a_format_that_does_not_fit_is_refused(of, format, run, tmp_path, capsys):
    file = str(run) if of == "run" else "thesis_range"
    assert main(["export", "--format", format, file, "--out", str(tmp_path / "x")]) == 2
    assert f"a {of} is not converted to {format}" in capsys.readouterr().err
