"""Many inputs at once through the command line; the work is done in this process."""

from __future__ import annotations

import json

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest

from piezo_rig.cli import main
from piezo_rig.commands import every_file, identify

RATE = 1000.0


@pytest.fixture(autouse=True)
def here(monkeypatch):
    """No processes: they are tested where they are."""
    monkeypatch.setattr(every_file, "_outcomes", lambda _, work, items: (work(i) for i in items))


def recording(path, upper=50.0, stiffness=0.08, start=0.0):
    """Three play operators, a spring and 2 nm of noise, sample by sample: nothing of ours."""
    half = np.linspace(0.0, upper, 126)
    drive = np.append(np.tile(np.concatenate([half[:-1], half[:0:-1]]), 3), 0.0)
    state, moved = np.zeros(3), []
    for v in drive:
        state = np.clip(state, v - np.array([3.0, 9.0, 20.0]), v + np.array([3.0, 9.0, 20.0]))
        moved.append(stiffness * v + np.array([0.02, 0.03, 0.015]) @ state)
    noisy = np.array(moved) + 2e-3 * np.random.default_rng(int(upper)).standard_normal(drive.size)
    table = np.column_stack([start + np.arange(drive.size) / RATE, drive, noisy])
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, table, delimiter=",", header="time_s,drive_v,displacement_um", comments="",
               fmt="%.9g")  # fmt: skip
    return str(path)


def identified(data, out, *more):
    return main(["identify", *data, "--model", "classical", "--elements", "10", "--out", str(out),
                 *more])  # fmt: skip


def table(folder):
    return pq.read_table(folder / "summary.parquet").to_pylist()


@pytest.fixture
def data(tmp_path):
    return [recording(tmp_path / "a" / "x.csv"), recording(tmp_path / "b" / "x.csv", 60.0)]


def test_each_gets_the_very_model_that_it_gets_alone(tmp_path, data):
    out = tmp_path / "models"  # several files, no ending: a folder
    assert identified(data, out) == 0
    for row in table(out):
        alone = tmp_path / "alone.json"
        assert identified([row["file"]], alone) == 0
        with open(row["output"], "rb") as handle:
            assert handle.read() == alone.read_bytes()


def test_the_table_says_what_each_is_and_how_it_moves(tmp_path, data, capsys):
    (tmp_path / "b" / "bad.csv").write_text("nothing\n")
    assert identified([*data, str(tmp_path / "b" / "bad.csv")], f"{tmp_path}/m/") == 0
    first, _, bad = table(tmp_path / "m")
    assert [first["status"], bad["status"]] == ["done", "failed"]
    assert bad["error_code"]
    assert bad["error_text"]
    assert (first["origin"], first["sweeps"], first["samples"]) == ("IMPORTED", 1, 751)
    assert (first["drive_min_v"], first["drive_max_v"]) == (0.0, 50.0)
    # a settled loop from 0 to 50 V: the spring, and each play operator less twice its threshold
    travel = 0.08 * 50 + 0.02 * 44 + 0.03 * 32 + 0.015 * 10
    assert first["um_per_v"] == pytest.approx(travel / 50, rel=0.01)
    said = capsys.readouterr().out
    assert "assumed: " in said
    assert said.splitlines()[-2:] == [f"summary: {tmp_path}/m/summary.parquet",
                                      f"page: {tmp_path}/m/summary.html"]  # fmt: skip


def test_what_is_done_is_not_done_again_until_it_changes(tmp_path, data, monkeypatch, capsys):
    worked, analysed = [], identify._analysed

    def counted(options, item, place):
        worked.append(item.name)
        return analysed(options, item, place)

    monkeypatch.setattr(identify, "_analysed", counted)
    out = tmp_path / "m"
    assert identified(data, out) == 0
    before = table(out)
    assert identified(data, out) == 0
    assert worked == ["a_x.csv", "b_x.csv"]
    assert "2 of 2 identified, 2 of them unchanged" in capsys.readouterr().out
    assert table(out) == before
    recording(tmp_path / "b" / "x.csv", 61.0)
    assert identified(data, out) == 0
    assert worked[2:] == ["b_x.csv"]
    (out / "a_x.csv_classical.json").write_text("{}")
    assert identified(data, out) == 0
    assert worked[3:] == ["a_x.csv"]
    assert identified(data, out, "--seed", "1") == 0
    assert worked[4:] == ["a_x.csv", "b_x.csv"]


def test_a_folder_among_data_is_one_actuator_with_its_files_joined(tmp_path, data):
    recording(tmp_path / "a" / "y.csv", 40.0, start=100.0)
    assert identified([str(tmp_path / "a"), data[1]], f"{tmp_path}/m/") == 0
    joined, alone = table(tmp_path / "m")
    assert (joined["sweeps"], alone["sweeps"]) == (2, 1)
    runs = json.loads((tmp_path / "m" / "a_classical.json").read_text())["provenance"]["runs"]
    assert [r["name"] for r in runs] == ["x.csv", "y.csv"]


def test_runs_of_two_actuators_in_a_folder_are_not_joined(tmp_path, data, capsys):
    (tmp_path / "both").mkdir()
    for i, name in enumerate(data):
        run = tmp_path / "both" / f"{i}.h5"
        assert main(["import", name, "--out", str(run)]) == 0
        with h5py.File(run, "r+") as f:
            f["entry"].require_group("sample").attrs["serial"] = f"S{i}"
    assert identified([str(tmp_path / "both"), data[0]], f"{tmp_path}/m/") == 0
    assert "error[different-actuators]: the runs are of S0 and S1" in capsys.readouterr().err
    runs = [str(tmp_path / "both" / f"{i}.h5") for i in range(2)]
    assert identified(runs, f"{tmp_path}/each/") == 0
    assert [r["actuator"] for r in table(tmp_path / "each")] == ["S0", "S1"]


def test_only_where_every_file_failed_the_status_says_so(tmp_path, capsys):
    bad = [tmp_path / f"{n}.csv" for n in "ab"]
    for path in bad:
        path.write_text("nothing\n")
    assert identified(map(str, bad), f"{tmp_path}/m/") == 2
    said = capsys.readouterr()
    assert said.err.count("error[") == 2
    assert "0 of 2 identified; failed: " in said.out
    assert [r["status"] for r in table(tmp_path / "m")] == ["failed", "failed"]


def test_a_stop_keeps_what_is_done_and_names_what_is_not(tmp_path, data, monkeypatch, capsys):
    def stopped(_, work, items):
        yield work(items[0])
        raise KeyboardInterrupt

    monkeypatch.setattr(every_file, "_outcomes", stopped)
    assert identified(data, f"{tmp_path}/m/") == 5
    said = capsys.readouterr().err
    assert said.startswith("error[aborted]: stopped by the operator; 1 of 2 files were done")
    assert f"not done: {data[1]}" in said
    assert [r["status"] for r in table(tmp_path / "m")] == ["done"]


@pytest.mark.parametrize(("words", "code", "status"), [
    (["--model", "perfect", "--out", "{}/m/"], "unknown-model", 2),
    (["--model", "classical", "--out", "{}/m.json", "--scheduler", "h:1"], "usage", 2),
    (["--model", "classical", "--out", "{}/a/x.csv/m/"], "disk", 4),
])  # fmt: skip
def test_a_slip_is_said_once_and_before_the_work(tmp_path, data, capsys, words, code, status):
    assert main(["identify", *data, *(w.format(tmp_path) for w in words)]) == status
    said = capsys.readouterr().err
    assert said.startswith(f"error[{code}]")
    assert said.count("error[") == 1


def test_every_one_of_data_is_diagnosed_by_itself_into_folders(tmp_path, data):
    out, models = tmp_path / "d", tmp_path / "models"
    models.mkdir()
    assert main(["diagnose", *data, "--json", f"{out}/", "--save-model", str(models)]) == 0
    for row, name in zip(table(out), ("a_x.csv", "b_x.csv"), strict=True):
        found = json.loads((out / f"{name}.json").read_text())
        assert found["data"]["sweeps"] == row["sweeps"] == 1
        assert row["rms_nm"] == found["baseline"]["rms_nm"]
        assert row["findings"] == [f["cause"] for f in found["findings"]]
        assert row["unexplained"] == found["unexplained"]["detected"]
        for finding in found["findings"]:
            assert row[f"{finding['cause']}.p_value"] == finding["p_value"]
        assert (models / f"{name}_extended.json").is_file()


def test_outputs_of_many_diagnoses_are_folders(tmp_path, data, capsys):
    assert main(["diagnose", *data, "--json", f"{tmp_path}/d/",
                 "--report", f"{tmp_path}/r.html"]) == 2  # fmt: skip
    assert "--report" in capsys.readouterr().err
    assert not (tmp_path / "d").exists()
