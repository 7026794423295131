"""Where `diagnose` writes, what it refuses, and which data it joins."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest

from piezo_rig.cli import main

RATE = 1000.0


def recording(path, upper=50.0, start=0.0, cycles=3, seed=0):
    """Three play operators, a spring and 2 nm of noise, sample by sample: nothing of ours."""
    half = np.linspace(0.0, upper, 126)
    drive = np.append(np.tile(np.concatenate([half[:-1], half[:0:-1]]), cycles), 0.0)
    state, moved = np.zeros(3), []
    for v in drive:
        state = np.clip(state, v - np.array([3.0, 9.0, 20.0]), v + np.array([3.0, 9.0, 20.0]))
        moved.append(0.08 * v + np.array([0.02, 0.03, 0.015]) @ state)
    noisy = np.array(moved) + 2e-3 * np.random.default_rng(seed).standard_normal(drive.size)
    table = np.column_stack([start + np.arange(drive.size) / RATE, drive, noisy])
    np.savetxt(path, table, delimiter=",", header="time_s,drive_v,displacement_um", comments="",
               fmt="%.9g")  # fmt: skip
    return str(path)


@pytest.fixture
def data(tmp_path):
    return [recording(tmp_path / "first.csv"),
            recording(tmp_path / "second.csv", 70.0, start=100.0, seed=1)]  # fmt: skip


def said(capsys):
    return dict(
        line.split(": ", 1) for line in capsys.readouterr().out.splitlines()
        if line.startswith(("json: ", "model: ", "figure: "))
    )  # fmt: skip


def test_data_given_together_are_one_diagnosis_and_folders_take_its_files(tmp_path, data, capsys):
    out = tmp_path / "new" / "place"
    assert main(["diagnose", *data, "--json", f"{out}/d.json", "--save-model", f"{out}/",
                 "--figure", f"{out}/"]) == 0  # fmt: skip
    assert said(capsys) == {
        "json": f"{out}/d.json", "model": f"{out}/first_extended.json",
        "figure": f"{out}/first_ladder.png",
    }  # fmt: skip
    found = json.loads((out / "d.json").read_text())
    assert found["schema"] == "piezo-rig/diagnosis/1"
    assert [r["name"] for r in found["data"]["recordings"]] == ["first.csv", "second.csv"]
    model = json.loads((out / "first_extended.json").read_text())
    assert model["schema"] == "piezo-rig/model/1"
    assert (out / "first_ladder.png").read_bytes().startswith(b"\x89PNG")


def test_a_folder_that_exists_needs_no_slash_and_a_file_is_a_file(tmp_path, data, capsys):
    (tmp_path / "out").mkdir()
    named = tmp_path / "named.json"
    assert main(["diagnose", data[0], "--json", str(tmp_path / "out"),
                 "--save-model", str(named)]) == 0  # fmt: skip
    assert said(capsys) == {"json": str(tmp_path / "out" / "first.json"), "model": str(named)}
    assert named.is_file()


@pytest.mark.parametrize("option", ["--json", "--save-model", "--figure"])
def test_what_cannot_be_written_is_said_before_the_diagnosis(tmp_path, data, capsys, option):
    (tmp_path / "taken").write_text("")
    (tmp_path / "closed").mkdir(mode=0o500)
    places = [f"{tmp_path}/taken/x.png", f"{tmp_path}/taken/"]
    if os.geteuid() != 0:  # root may write anywhere
        places.append(f"{tmp_path}/closed/x.png")
    for place in places:
        assert main(["diagnose", *data, option, place]) == 4
        out, err = capsys.readouterr()
        assert err.startswith("error[disk]: could not write")
        assert f"give another {option}" in err
        assert "the ladder" not in out


def test_no_output_takes_the_place_of_another_or_of_an_input(tmp_path, data, capsys):
    same = str(tmp_path / "x.json")
    assert main(["diagnose", *data, "--json", same, "--save-model", same]) == 2
    assert "two outputs" in capsys.readouterr().err
    baseline = tmp_path / "models" / "first.json"
    baseline.parent.mkdir()
    baseline.write_text("{}")
    assert main(["diagnose", *data, "--baseline", str(baseline),
                 "--json", str(baseline.parent)]) == 2  # fmt: skip
    assert capsys.readouterr().err.startswith("error[overwrites-input]: --json")
    assert baseline.read_text() == "{}"


def test_a_figure_of_an_unknown_kind_is_refused(tmp_path, data, capsys):
    assert main(["diagnose", *data, "--figure", str(tmp_path / "ladder.doc")]) == 2
    assert ".png" in capsys.readouterr().err


def test_data_of_different_origin_are_joined_only_where_meant(
    tmp_path, data, monkeypatch, capsys
):
    from piezo_rig.run_file import reader

    run = str(tmp_path / "imported.h5")
    assert main(["import", data[0], "--out", run]) == 0
    read = reader.read_sweep
    monkeypatch.setattr(  # no bench is played for this: the run's sweeps say that they are
        reader, "read_sweep", lambda *a: read(*a).with_(origin="SIMULATED")
    )
    words = ["diagnose", run, data[1], "--json", str(tmp_path / "d.json")]
    assert main(words) == 2
    assert capsys.readouterr().err.startswith("error[mixed-origin]: the data are IMPORTED and SIM")
    assert not (tmp_path / "d.json").exists()
    assert main([*words, "--mixed-origin"]) == 0
    assert json.loads((tmp_path / "d.json").read_text())["data"]["sweeps"] == 2
