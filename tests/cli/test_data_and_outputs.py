"""What the verbs that read data keep, refuse and warn of."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest

from piezo_rig.cli import main

DRIVE = "time_s,drive_v"
DATA = "time_s,drive_v,displacement_um"
RATE = 1000.0


def ride(*turns):
    return np.concatenate([turns[:1], *(np.linspace(a, b, 201)[1:] for a, b in pairwise(turns))])


def played(drive):
    """Three play operators and a spring, sample by sample: nothing of the program's."""
    state, out = np.zeros(3), []
    for v in drive:
        state = np.clip(state, v - np.array([3.0, 9.0, 20.0]), v + np.array([3.0, 9.0, 20.0]))
        out.append(0.08 * v + np.array([0.02, 0.03, 0.015]) @ state)
    return np.array(out)


def written(path, drive, moved=None, start=0.0):
    columns = [start + np.arange(drive.size) / RATE, drive] + ([] if moved is None else [moved])
    header = DRIVE if moved is None else DATA
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="",
               fmt="%.17g")
    return str(path)


@pytest.fixture
def recording(tmp_path):
    drive = ride(0.0, 60.0, 0.0, 60.0, 0.0, 60.0, 0.0)
    return written(tmp_path / "r.csv", drive, played(drive))


@pytest.fixture
def model(tmp_path, recording):
    out = str(tmp_path / "model.json")
    assert main(["identify", recording, "--model", "classical", "--elements", "30",
                 "--history", "virgin", "--out", out]) == 0
    return out


def test_no_verb_writes_over_what_it_reads(tmp_path, recording, model, capsys):
    (tmp_path / "link.csv").symlink_to(recording)
    link = str(tmp_path / "link.csv")
    cases = [
        ["identify", recording, "--model", "classical", "--out", recording],
        ["identify", recording, "--model", "classical", "--out", link],
        ["simulate", model, recording, "--out", recording],
        ["simulate", model, recording, "--out", model],
        ["diagnose", recording, "--json", recording],
        ["diagnose", recording, "--baseline", model, "--save-model", model],
        ["import", recording, "--out", recording],
    ]
    before = {p: p.read_bytes() for p in tmp_path.iterdir()}
    for words in cases:
        capsys.readouterr()
        assert main(words) == 2
        said = capsys.readouterr().err
        assert said.startswith("error[overwrites-input]: --")
        assert words[-1] in said
    assert {p: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_the_name_of_a_model_is_no_input(tmp_path, recording, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for _ in range(2):  # the second time a file of that name exists
        assert main(["identify", recording, "--model", "classical", "--elements", "5",
                     "--out", "classical"]) == 0


def test_two_files_of_one_name_are_two_in_the_provenance(tmp_path):
    paths = []
    for folder, top in (("a", 40.0), ("b", 60.0)):
        (tmp_path / folder).mkdir()
        drive = ride(0.0, top, 0.0, top, 0.0)
        paths.append(written(tmp_path / folder / "x.csv", drive, played(drive)))
    out = tmp_path / "m.json"
    assert main(["identify", *paths, "--model", "classical", "--elements", "5",
                 "--out", str(out)]) == 0
    provenance = json.loads(out.read_text())["provenance"]
    assert provenance["runs"] == [
        {"name": f"{folder}/x.csv",
         "sha256": hashlib.sha256((tmp_path / folder / "x.csv").read_bytes()).hexdigest()}
        for folder in ("a", "b")
    ]
    assert [s["repeat"] for s in provenance["sweeps"]] == [1, 1]
    assert len({s["condition"] for s in provenance["sweeps"]}) == 2


def test_a_drive_and_a_command_of_one_bench_are_joined(tmp_path, recording):
    drive = ride(0.0, 60.0, 0.0, 60.0, 0.0)
    path = written(tmp_path / "command.csv", (drive - 75.0) / 7.5, played(drive))
    text = (tmp_path / "command.csv").read_text().replace("drive_v", "command_v", 1)
    (tmp_path / "command.csv").write_text(text)
    for data in ([recording, path], [path, recording]):
        assert main(["identify", *data, "--model", "classical", "--elements", "5",
                     "--out", str(tmp_path / "m.json")]) == 0


def test_carried_history_goes_on_from_sweep_to_sweep(tmp_path, model):
    drive = ride(0.0, 55.0, 20.0, 50.0, 10.0, 40.0, 0.0)
    whole = str(tmp_path / "whole.csv")
    assert main(["simulate", model, written(tmp_path / "d.csv", drive), "--out", whole]) == 0
    parts, moved = [], played(drive)
    for k, (a, b) in enumerate(pairwise((0, 330, 700, drive.size))):
        path = tmp_path / f"part{k}.csv"
        parts.append(written(path, drive[a:b], moved[a:b], start=a / RATE))
    run, out = str(tmp_path / "run.h5"), str(tmp_path / "out.csv")
    assert main(["import", *parts, "--history", "carried", "--out", run]) == 0
    assert main(["simulate", model, run, "--history", "carried", "--out", out]) == 0
    expected, got = (np.genfromtxt(p, delimiter=",", names=True) for p in (whole, out))
    for name in ("time_s", "drive_v", "displacement_um"):
        np.testing.assert_allclose(got[name], expected[name], atol=1e-9)
    assert main(["simulate", model, run, "--out", out]) == 0  # virgin: each from its own 0
    assert np.genfromtxt(out, delimiter=",", names=True)["displacement_um"][330] == 0.0


def test_a_first_rise_that_the_data_did_not_hold_is_said(tmp_path, recording, capsys):
    table = np.loadtxt(recording, delimiter=",", skiprows=1)
    settled = written(tmp_path / "s.csv", table[400:, 1], table[400:, 2])
    out, moved = str(tmp_path / "m.json"), str(tmp_path / "o.csv")
    assert main(["identify", settled, "--model", "classical", "--elements", "10",
                 "--out", out]) == 0
    known = json.loads((tmp_path / "m.json").read_text())["provenance"]["known_v"]
    assert known == {"first_rise": 30.0, "branch": 60.0}
    for history, warned in (("virgin", True), ("unknown", False)):
        capsys.readouterr()
        words = ["simulate", out, settled, "--history", history, "--out", moved]
        assert main(words) == 0
        said = capsys.readouterr().out
        assert ("goes 60 V from its virgin start, but the model's data knew the first rise up to "
                "30 V" in said) == warned


def test_branches_longer_than_the_data_held_are_said(tmp_path, capsys):
    drive = ride(0.0, 60.0, 45.0, 60.0, 45.0, 60.0)
    path = written(tmp_path / "r.csv", drive, played(drive))
    full = written(tmp_path / "d.csv", ride(0.0, 60.0, 0.0))
    near = written(tmp_path / "n.csv", ride(0.0, 60.0, 50.0, 55.0, 45.0))
    out, moved = str(tmp_path / "m.json"), str(tmp_path / "o.csv")
    assert main(["identify", path, "--model", "initiation", "--history", "virgin",
                 "--elements", "10", "--out", out]) == 0
    for played_drive, warned in ((full, True), (near, False)):
        capsys.readouterr()
        assert main(["simulate", out, played_drive, "--out", moved]) == 0
        said = capsys.readouterr().out
        assert ("60 V along one branch from a turning point, but the model's data knew branches "
                "up to 15 V" in said) == warned


def test_the_largest_number_of_elements_is_one(tmp_path, recording, capsys):
    from piezo_rig.errors import InputError
    from piezo_rig.identification import identify
    from piezo_rig.run_file.importers import read_recordings

    words = ["identify", recording, "--model", "classical", "--out", str(tmp_path / "m.json")]
    assert main([*words, "--elements", "501"]) == 2
    assert "1 to 500" in capsys.readouterr().err
    with pytest.raises(InputError, match="501"):
        identify(read_recordings([recording]).sweeps, "classical", elements=501)


def test_sums_do_not_depend_on_the_threads_that_an_environment_asks_for():
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    program = f"import os, piezo_rig; print([os.environ[n] for n in {names}])"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True,
        env=os.environ | dict.fromkeys(names, "4"),
    )  # fmt: skip
    assert done.stdout.strip() == "['1', '1', '1']"


def test_a_file_that_is_given_more_than_once_is_read_once(tmp_path, recording, capsys):
    other = tmp_path / "link.csv"
    other.symlink_to(recording)
    for out, words in (("once", [recording]), ("thrice", [recording, recording, str(other)])):
        assert main(["identify", *words, "--model", "classical", "--elements", "30",
                     "--history", "virgin", "--out", str(tmp_path / f"{out}.json")]) == 0
        said = capsys.readouterr().out
        assert said.count("given more than once, read once") == 2 * (out == "thrice")
    once, thrice = (json.loads((tmp_path / f"{n}.json").read_text()) for n in ("once", "thrice"))
    assert once["stages"] == thrice["stages"]
