"""`identify` and `simulate` through the command line."""

from __future__ import annotations

import json

import numpy as np
import pytest

from piezo_rig.cli import main


def triangle(upper: float, cycles: int = 3, per_cycle: int = 1000) -> np.ndarray:
    phase = np.arange(cycles * per_cycle + 1) / per_cycle
    return upper * (1 - np.abs(2 * (phase % 1.0) - 1))


def play_elements(drive: np.ndarray) -> np.ndarray:
    """Three play operators and a spring, sample by sample: nothing of the program's."""
    thresholds, weights = (3.0, 9.0, 20.0), (0.02, 0.03, 0.015)
    states = [0.0, 0.0, 0.0]
    out = np.empty(drive.size)
    for i, v in enumerate(drive):
        total = 0.08 * v
        for j, (r, w) in enumerate(zip(thresholds, weights, strict=True)):
            states[j] = max(v - r, min(v + r, states[j]))
            total += w * states[j]
        out[i] = total
    return out


def recording(path, upper: float) -> np.ndarray:
    drive = triangle(upper)
    moved = play_elements(drive)
    table = np.column_stack([np.arange(drive.size) / 2000, drive, moved])
    np.savetxt(path, table, delimiter=",", comments="", header="time_s,drive_v,displacement_um")
    return table


@pytest.fixture
def data(tmp_path):
    for upper in (20, 40, 60):
        recording(tmp_path / f"r{upper}.csv", upper)
    return [str(tmp_path / f"r{upper}.csv") for upper in (20, 40, 60)]


def test_a_model_identified_from_recordings_predicts_another_drive(data, tmp_path, capsys):
    model, out = tmp_path / "m.json", tmp_path / "out.csv"
    words = ["--model", "classical", "--history", "virgin", "--elements", "60"]
    assert main(["identify", *data, *words, "--out", str(model)]) == 0
    assert f"model: {model}" in capsys.readouterr().out
    legs = (np.linspace(25, 45, 300), np.linspace(45, 10, 300))
    drive = np.concatenate([triangle(50)[:-500], *legs])
    path = tmp_path / "drive.csv"
    np.savetxt(path, np.column_stack([np.arange(drive.size) / 2000, drive]), delimiter=",",
               comments="", header="time_s,drive_v")
    assert main(["simulate", str(model), str(path), "--out", str(out)]) == 0
    table = np.genfromtxt(out, delimiter=",", names=True)
    assert table.dtype.names == ("time_s", "drive_v", "displacement_um")
    assert table.size == drive.size
    assert table["displacement_um"][0] == 0.0
    expected = play_elements(drive)
    assert np.abs(table["displacement_um"] - expected).max() < 0.01 * np.ptp(expected)


def test_the_same_data_give_the_same_bytes(data, tmp_path):
    for name in ("a.json", "b.json"):
        assert main(["identify", *data, "--model", "classical", "--elements", "10",
                     "--out", str(tmp_path / name)]) == 0
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


def test_a_model_says_from_which_files_by_hash(data, tmp_path):
    import hashlib
    from pathlib import Path

    out = tmp_path / "m.json"
    main(["identify", *data, "--model", "classical", "--elements", "10", "--out", str(out)])
    runs = json.loads(out.read_text())["provenance"]["runs"]
    assert {r["name"]: r["sha256"] for r in runs} == {
        Path(p).name: hashlib.sha256(Path(p).read_bytes()).hexdigest() for p in data
    }


def test_a_folder_as_out_gets_one_model_for_every_file_and_a_bad_one_stops_none(
    data, tmp_path, capsys
):
    bad = tmp_path / "constant.csv"
    bad.write_text("time_s,drive_v,displacement_um\n" + "".join(
        f"{k / 100},5.0,1.0\n" for k in range(200)))
    folder = tmp_path / "models"
    assert main(["identify", *data, str(bad), "--model", "classical", "--elements", "10",
                 "--out", f"{folder}/"]) == 0
    assert sorted(p.name for p in folder.iterdir()) == [
        "journal.jsonl", "r20_classical.json", "r40_classical.json", "r60_classical.json",
        "summary.html", "summary.parquet",
    ]
    said = capsys.readouterr()
    assert said.err.startswith("error[")
    assert "constant.csv" in said.err
    assert f"3 of 4 identified; failed: {bad}" in said.out


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["--model", "perfect"], "unknown-model"),
        (["--model", "classical", "--elements", "0"], "usage"),
    ],
)
def test_a_slip_is_told(data, tmp_path, capsys, words, code):
    assert main(["identify", *data, *words, "--out", str(tmp_path / "m.json")]) == 2
    assert capsys.readouterr().err.startswith(f"error[{code}]")


def test_data_of_different_origin_are_not_joined_unasked(data, tmp_path, capsys):
    import h5py

    run = tmp_path / "r.h5"
    assert main(["import", data[0], "--out", str(run)]) == 0
    with h5py.File(run, "r+") as f:
        f["entry"].attrs["origin"] = "SIMULATED"
        f["entry/sweep_0001"].attrs["origin"] = "SIMULATED"
    words = ["identify", str(run), *data[1:], "--model", "classical", "--elements", "10",
             "--out", str(tmp_path / "m.json")]
    assert main(words) == 2
    assert capsys.readouterr().err.startswith("error[mixed-origin]")
    assert main([*words, "--mixed-origin"]) == 0


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("{", "JSON"),
        ('{"schema": "other/1"}', "schema"),
        ('{"schema": "piezo-rig/model/1", "stages": [{"id": "gremlin"}]}', "gremlin"),
    ],
)
def test_a_broken_model_file_is_a_clear_error(tmp_path, capsys, text, what):
    model, drive = tmp_path / "m.json", tmp_path / "d.csv"
    model.write_text(text)
    drive.write_text("time_s,drive_v\n0,0\n1,1\n2,2\n")
    assert main(["simulate", str(model), str(drive), "--out", str(tmp_path / "o.csv")]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error[")
    assert what in said


def test_a_shipped_model_plays_by_name(tmp_path):
    drive, out = tmp_path / "d.csv", tmp_path / "o.csv"
    np.savetxt(drive, np.column_stack([np.arange(66.0), np.arange(66.0)]), delimiter=",",
               comments="", header="time_s,drive_v")
    assert main(["simulate", "thesis_range", str(drive), "--out", str(out)]) == 0
    last = np.genfromtxt(out, delimiter=",", names=True)[-1]
    assert round(float(last["displacement_um"]), 3) == 9.195  # Appendix A at 65 V
