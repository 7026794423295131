"""A bench whose measured gain and offset are not quite the nominal ones can be used."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from piezo_rig.cli import main
from piezo_rig.config import load_rig
from piezo_rig.config.rig import command_max_for
from piezo_rig.resources import shipped_folder

SIMULATED = (shipped_folder("configs") / "simulated_bench.toml").read_text()
PROTOCOL = """schema = "piezo-rig/protocol/1"
name = "p"
sample_rate = 1000
[[condition]]
waveform = "triangle"
lower_v = 0
upper_v = {upper}
frequency_hz = 5
cycles = 3
"""


@pytest.fixture
def bench(tmp_path, monkeypatch, capsys):
    """A function: offset, a line under [waveform_dac] -> what `calibrate` printed.

    It leaves ``rig.toml``, with the calibration, in the current folder.
    """
    monkeypatch.chdir(tmp_path)

    def calibrated(offset: float, command: str = "") -> str:
        rows = [f"{c},{7.5 * c + offset:.3f}" for c in (-9, -7, -5, -3, -1)]
        Path("points.csv").write_text("\n".join(["command_v,drive_v", *rows]) + "\n")
        assert main(["calibrate", "points.csv", "--out", "cal.toml", "--set-voltage", "75"]) == 0
        Path("rig.toml").write_text(
            SIMULATED.replace('calibration = "amplifier"', 'calibration = "cal.toml"')
            .replace("[waveform_dac]\n", f"[waveform_dac]\n{command}\n")
        )
        return capsys.readouterr().out

    return calibrated


def plan(upper: float, capsys) -> tuple[int, str]:
    """Exit status and stderr of a plan from 0 V to a drive."""
    Path("p.toml").write_text(PROTOCOL.format(upper=upper))
    return main(["plan", "p.toml", "--rig", "rig.toml"]), capsys.readouterr().err


def test_the_command_for_a_drive_is_rounded_up_to_the_millivolt():
    assert command_max_for(75.0, 7.5, 75.0) == 0.0
    assert command_max_for(75.0, 7.5, 74.97) == 0.004
    assert command_max_for(75.0, 7.5, 74.96) == 0.006  # 5.33 mV
    assert command_max_for(75.0, 7.5, 75.3) == -0.04


def test_a_bench_with_all_that_calibrate_printed_plans_is_well_and_runs(bench, capsys):
    printed = bench(74.96)
    (line,) = re.findall(r"under \[waveform_dac\]: (.*)", printed)
    bench(74.96, line)
    assert plan(75, capsys) == (0, "")
    assert main(["doctor", "--rig", "rig.toml"]) == 0
    said = capsys.readouterr().out
    assert "no faults" in said
    assert "note   waveform_dac" not in said
    assert main(["run", "p.toml", "--rig", "rig.toml"]) == 0


@pytest.mark.parametrize("offset", [75.0, 75.04])
def test_nothing_more_is_printed_where_nothing_is_missing(bench, capsys, offset):
    assert "waveform_dac" not in bench(offset)
    assert plan(75, capsys) == (0, "")


def test_without_it_the_plan_names_what_to_write_and_how_far_to_play(bench, capsys):
    bench(74.96)
    status, error = plan(75, capsys)
    assert status == 3
    assert error.startswith("error[limit-command]: p.toml:7: condition 0-75, sample 100 ")
    assert "the calibration cal.toml" in error
    ((line, most),) = re.findall(
        r"set (.*) under \[waveform_dac\] in rig.toml, or play to (.*) V at most", error)
    assert (line, most) == ("command_max_v = 0.006", "74.96")
    assert plan(74.96, capsys) == (0, "")
    bench(74.96, line)
    assert plan(75, capsys) == (0, "")


def test_a_doctor_goes_as_far_as_the_command_does_and_says_so(bench, capsys):
    bench(74.96)
    assert main(["doctor", "--rig", "rig.toml"]) == 0
    said = capsys.readouterr().out
    assert "command_max_v = 0 ends the drive at 74.96 V; drive_max_v is 75 V" in said
    assert "set command_max_v = 0.006 under [waveform_dac] in rig.toml" in said
    assert "for 74.96 V" in said


def test_the_limit_of_the_stack_stays(bench, capsys):
    bench(74.96, "command_max_v = 0.05")
    status, error = plan(75.1, capsys)
    assert status == 3
    assert error.startswith("error[limit-drive]")
    assert load_rig("rig.toml").top_drive_v == 75.0


def test_no_one_is_told_to_raise_a_limit_by_more_than_a_calibration_shifts(bench, capsys):
    printed = bench(74.0)  # 1 V short
    assert "command_max_v" not in printed
    assert "0 V of command are 74 V on the stack" in printed
    status, error = plan(75, capsys)
    assert status == 3
    assert "do:    play to 74 V at most\n" in error
    assert "command_max_v" not in error


def test_a_command_that_was_limited_on_purpose_is_no_fault(bench, capsys):
    bench(75.0, "command_max_v = -2.0")
    assert main(["doctor", "--rig", "rig.toml"]) == 0
    said = capsys.readouterr().out
    assert "do:    play to 60 V at most" in said
    assert "for 60 V" in said
