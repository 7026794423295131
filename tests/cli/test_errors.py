"""What the command line says when something is wrong: one block, a code, an exit status."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from piezo_rig import cli
from piezo_rig.cli import main
from piezo_rig.config import load_rig
from piezo_rig.resources import shipped_folder


def said(capsys) -> str:
    return capsys.readouterr().err


def test_help_imports_nothing_heavy():
    program = (
        "import sys; from piezo_rig.cli import build_parser; build_parser().format_help();"
        "heavy = {'numpy', 'scipy', 'h5py', 'numba', 'matplotlib', 'pyvisa'} & set(sys.modules);"
        "sys.exit(', '.join(heavy) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("words", "status", "code"),
    [
        (["plan", "no_such_protocol"], 2, "file-missing"),
        (["plan", "quick_look", "--rig", "no_such_rig"], 2, "file-missing"),
        (["plan"], 2, "usage"),
        (["dance"], 2, "usage"),
        (["show", "no_such_run.h5"], 2, "file-missing"),
        (["verify", "no_such_run.h5"], 2, "file-missing"),
        (["run", "no_such_protocol"], 2, "file-missing"),
    ],
)
def test_a_slip_is_one_block_with_a_code(words, status, code, capsys):
    assert main(words) == status
    text = said(capsys)
    assert text.startswith(f"error[{code}]: ")
    assert "  do:" in text
    assert "Traceback" not in text


def test_a_missing_file_offers_what_is_shipped_of_its_kind(tmp_path, capsys):
    rig = tmp_path / "rig.toml"
    text = (shipped_folder("configs") / "simulated_bench.toml").read_text()
    rig.write_text(text.replace('calibration = "amplifier"', 'calibration = "amplifer"'))
    assert main(["plan", "quick_look", "--rig", str(rig)]) == 2
    error = said(capsys)
    assert "one of: amplifier, " in error
    assert "thesis_" not in error
    assert main(["compensate", "thesis_rang", "t.csv", "--out", str(tmp_path / "o.csv")]) == 2
    error = said(capsys)
    assert "thesis_range" in error
    assert "amplifier" not in error


@pytest.mark.parametrize("words", [
    ["calibrate", "points.csv"], ["compensate", "thesis_range", "target.csv"],
    ["import", "0-65.csv"], ["simulate", "thesis_range", "drive.csv"],
])  # fmt: skip
def test_a_folder_in_place_of_the_file_to_be_written_is_a_slip(words, tmp_path, capsys):
    assert main([*words, "--out", str(tmp_path)]) == 2
    assert said(capsys).startswith(f"error[usage]: --out {tmp_path}: a folder, not a file")


def test_80_v_in_the_thesis_matrix_is_refused_with_exit_3(tmp_path, capsys):
    text = (shipped_folder("protocols") / "thesis_matrix.toml").read_text()
    path = tmp_path / "matrix.toml"
    path.write_text(text.replace("70, 75]", "70, 80]"))
    assert main(["plan", str(path)]) == 3
    text = said(capsys)
    assert text.startswith("error[limit-drive]: ")
    assert "80.0" in text


def test_plan_says_what_it_checked(capsys):
    assert main(["plan", "thesis_matrix"]) == 0
    text = capsys.readouterr().out
    for word in ("2122500", "81 sweeps", "slew rate", "current C dV/dt", "DAC memory",
                 "digitizer record", "sensor output", "file"):
        assert word in text


def test_plan_draws_into_a_picture(tmp_path, capsys):
    figure = tmp_path / "plan.png"
    assert main(["plan", "minor_loops", "--figure", str(figure)]) == 0
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_a_folder_that_cannot_be_written_stops_the_run_before_it_begins(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["run", "quick_look", "--out", str(tmp_path / "file" / "runs")]) == 4
    text = said(capsys)
    assert text.startswith("error[disk]: ")
    assert "piezo" in text


def test_a_full_disk_stops_the_run_before_it_begins(tmp_path, capsys, monkeypatch):
    class Usage:
        free = 1000

    monkeypatch.setattr("shutil.disk_usage", lambda _: Usage)
    assert main(["run", "quick_look", "--out", str(tmp_path)]) == 4
    assert said(capsys).startswith("error[disk-full]: ")
    assert list(tmp_path.iterdir()) == []


def real_rig(tmp_path: Path, port: int) -> Path:
    text = (shipped_folder("configs") / "lab_example.toml").read_text()
    for old in ("192.168.0.10::5025", "192.168.0.11::5025"):
        text = text.replace(old, f"127.0.0.1::{port}")
    path = tmp_path / "rig.toml"
    path.write_text(text)
    assert load_rig(str(path)).simulated is False
    return path


def test_a_refused_port_is_exit_4_and_says_where_the_piezo_is(tmp_path, capsys):
    import socket

    with socket.socket() as free:  # bound but not listening: connections are refused
        free.bind(("127.0.0.1", 0))
        rig = real_rig(tmp_path, free.getsockname()[1])
        assert main(["run", "quick_look", "--rig", str(rig), "--out", str(tmp_path)]) == 4
    text = said(capsys)
    assert text.startswith("error[instrument-refused]: ")
    assert "piezo" in text
    assert "waveform_dac" in text


@pytest.mark.parametrize(("stopped", "words"), [
    (KeyboardInterrupt(), "stopped by the operator"),
    (KeyboardInterrupt("SIGTERM: a time limit, or another program"), "stopped by SIGTERM: a time"),
])  # fmt: skip
def test_it_is_said_who_stopped_a_program(monkeypatch, capsys, stopped, words):
    def stop():
        raise stopped

    monkeypatch.setattr(cli, "build_parser", stop)
    assert cli.main(["diagnose"]) == 5
    assert capsys.readouterr().err.startswith(f"error[aborted]: {words}")
