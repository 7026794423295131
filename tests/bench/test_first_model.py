"""The first model of a run is one that can be used, or is none."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest

from piezo_rig.cli import main
from piezo_rig.run_file.reader import Run

HEAD = 'schema = "piezo-rig/protocol/1"\nname = "p"\nsample_rate = 1000\n'
FILE = '[[condition]]\nname = "staircase"\nwaveform = "file"\npath = "drive.csv"\n'
STEPS = '[[condition]]\nwaveform = "steps"\nlevels_v = [30, 60, 30, 0]\nhold_s = 0.5\n'
BLANK = '[[condition]]\nwaveform = "blank"\nduration_s = 1\n'
TRIANGLE = ('[[condition]]\nwaveform = "triangle"\nlower_v = 0\nupper_v = 40\nfrequency_hz = 2\n'
            "cycles = 4\n")  # fmt: skip
STAIRCASE = "time_s,drive_v\n0,0\n0.1,9\n0.2,9\n0.4,17\n0.6,17\n"


@pytest.fixture
def ran(tmp_path, monkeypatch, capsys):
    """A function: conditions of a protocol -> the run, and the lines that `run` printed."""
    monkeypatch.chdir(tmp_path)

    def play(conditions: str) -> tuple[Path, list[str]]:
        Path("p.toml").write_text(HEAD + conditions)
        Path("drive.csv").write_text(STAIRCASE)
        assert main(["run", "p.toml", "--out", "runs"]) == 0
        (run,) = Path("runs").glob("*.h5")
        return run, capsys.readouterr().out.splitlines()

    return play


@pytest.mark.parametrize(("conditions", "waveform"), [(FILE, "file"), (STEPS, "steps")])
def test_no_model_is_written_where_none_can_be_used_and_the_reason_is_said(
    ran, capsys, conditions, waveform
):
    run, lines = ran(conditions)
    assert [line.partition(" (")[0] for line in lines[-2:]] == ["model: none", "figure: none"]
    assert not list(Path("runs").glob("*.json"))
    assert not list(Path("runs").glob("*.png"))
    said = "\n".join(lines)
    assert "\nno model: " in said
    assert "largest error" not in said
    assert f'read off cycles between two voltages; waveform = "{waveform}" is another' in said
    (advice,) = [line.partition(": piezo-rig ")[2] for line in lines if "by least squares" in line]
    assert main(shlex.split(advice)) == 0
    provenance = json.loads(Path("MODEL.json").read_text())["provenance"]
    (sweep,) = Run(run).sweeps()
    travel_nm = 1e3 * (sweep.displacement_um.max() - sweep.displacement_um.min())
    assert provenance["rms_nm"] < 0.02 * travel_nm


def test_a_model_that_follows_worse_than_a_line_says_by_how_much(ran):
    _, lines = ran(FILE)
    (said,) = [line for line in lines if line.startswith("no model: ")]
    words = said.split()
    off, line = (float(words[i - 1]) for i, w in enumerate(words) if w == "nm")
    assert off > line > 3.0  # 3 nm are the sensor's noise
    assert "model: none (worse-than-a-line)" in lines


def test_whole_cycles_stand_in_for_a_wider_drive_without_any(ran):
    _, lines = ran(STEPS + TRIANGLE)
    assert "0-75 V was not played; 0-40 stands in for it" in lines
    (model,) = Path("runs").glob("*.json")
    assert f"model: {model}" in lines


def test_a_blank_is_not_sent_to_another_scheme(ran):
    _, lines = ran(BLANK)
    assert "model: none (constant-drive)" in lines
    assert not any("piezo-rig identify" in line for line in lines)
