"""A protocol plays a drive from a file; the run can be gone on with by itself."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from piezo_rig.bench import open_bench
from piezo_rig.cli import main
from piezo_rig.config import load_rig
from piezo_rig.errors import BenchError, LimitError, PiezoRigError
from piezo_rig.protocol import build_plan, load_protocol
from piezo_rig.protocol.drive_file import pack, unpack
from piezo_rig.replay.past_bench import plan_of as plan_of_the_past
from piezo_rig.run_file.reader import Run
from piezo_rig.runner import Wire, play

TEXT = """
schema = "piezo-rig/protocol/1"
name = "files"
sample_rate = {rate}
[[condition]]
name = "followed"
waveform = "file"
path = "drives/d.csv"
[[condition]]
waveform = "triangle"
lower_v = 0
upper_v = 40
frequency_hz = 20
cycles = 2
"""
RISE = np.concatenate([np.linspace(0.0, 40.0, 401), np.linspace(40.0, 10.0, 301)[1:]])


def protocol_in(folder: Path, drive=RISE, step=1 / 5000, rate=5000, begin=0.0) -> Path:
    (folder / "drives").mkdir(exist_ok=True)
    table = np.column_stack([begin + step * np.arange(len(drive)), drive])
    np.savetxt(folder / "drives" / "d.csv", table, delimiter=",", header="time_s,drive_v",
               comments="", fmt="%.12g")  # fmt: skip
    path = folder / "files.toml"
    path.write_text(TEXT.format(rate=rate))
    return path


def plan_of(path: Path):
    return build_plan(load_protocol(path), load_rig())


def test_the_rows_are_played_and_the_way_back_to_rest_after_them(tmp_path):
    plan = plan_of(protocol_in(tmp_path))
    wave = plan.sweeps[0].wave
    half_a_step = 0.5 * 40.0 / 65534
    np.testing.assert_allclose(wave.drive_v[: RISE.size], RISE, atol=1.01 * half_a_step)
    assert wave.drive_v[-1] < 300.0 / 5000  # 10 V at the approach's 300 V/s, and rest
    assert wave.drive_v.size == pytest.approx(RISE.size + 10.0 / 300 * 5000, abs=5)


def test_a_file_of_another_rate_is_drawn_with_straight_lines(tmp_path):
    plan = plan_of(protocol_in(tmp_path, drive=[0.0, 20.0, 10.0], step=0.01, begin=7.0))
    wave = plan.sweeps[0].wave
    np.testing.assert_allclose(wave.drive_v[[25, 50, 75]], [10.0, 20.0, 15.0], atol=1e-3)


def test_a_file_that_begins_elsewhere_is_approached(tmp_path):
    drive = plan_of(protocol_in(tmp_path, drive=np.linspace(30, 40, 101))).sweeps[0].wave.drive_v
    approach = round(30.0 / 300 * 5000)
    np.testing.assert_allclose(drive[[0, approach, approach + 100]], [0.0, 30.0, 40.0], atol=2e-3)


@pytest.mark.parametrize(
    ("drive", "code"),
    [([0.0, 80.0, 0.0], "limit-drive"), ([0.0, -1.0, 0.0], "limit-drive")],
)
def test_levels_are_checked_as_of_any_waveform(tmp_path, drive, code):
    with pytest.raises(LimitError) as error:
        plan_of(protocol_in(tmp_path, drive=drive, step=0.1))
    assert error.value.code == code


def test_steps_are_checked_as_of_any_waveform(tmp_path):
    with pytest.raises(LimitError) as error:
        plan_of(protocol_in(tmp_path, drive=[0.0] * 20 + [30.0] * 20))
    assert error.value.code == "limit-slew"
    assert "condition followed, sample 20" in str(error.value)


@pytest.mark.parametrize(
    "text",
    ["time_s,displacement_um\n0,0\n1,1\n", "time_s,drive_v\n0,0\n", "time_s,drive_v\n0,0\n0,1\n",
     "time_s,drive_v\n0,0\n1,nan\n", "time_s,drive_v\n0,0\n1,1e6\n", "time_s,drive_v\n0,0\n1\n"],
)  # fmt: skip
def test_a_bad_file_is_refused_in_words(tmp_path, text):
    path = protocol_in(tmp_path)
    (tmp_path / "drives" / "d.csv").write_text(text)
    with pytest.raises(PiezoRigError) as error:
        load_protocol(path)
    assert error.value.exit_status == 2
    assert "d.csv" in error.value.what


def test_another_content_is_another_plan(tmp_path):
    before = plan_of(protocol_in(tmp_path)).hash
    assert plan_of(protocol_in(tmp_path)).hash == before
    assert plan_of(protocol_in(tmp_path, drive=RISE + 1e-9)).hash != before


def test_files_are_packed_and_unpacked():
    files = {"a.csv": "time_s,drive_v\n0,0\n" * 1000, "b/ü.csv": "µ"}
    assert unpack(pack(files), "run") == files
    assert len(pack(files)) < 1000
    for broken in ('{"a": 1}', "[]", "{", '{"a": "!!"}'):
        with pytest.raises(PiezoRigError):
            unpack(broken, "run")


def test_a_run_is_resumed_and_planned_again_without_the_file(tmp_path, capsys):
    path = protocol_in(tmp_path)
    plan = plan_of(path)
    left = 1

    def tell(line: str) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            raise BenchError("instrument-timeout", "digitizer: did not answer")

    wire, run = Wire(), tmp_path / "r.h5"
    with suppress(BenchError), open_bench(plan.rig, lambda question: True, wire) as bench:
        play(plan, bench, run, wire, tell)
    stored = Run(run).sweeps()[0]
    assert stored.details["sha256"] == plan.protocol.conditions[0].details["sha256"]
    drive_file = tmp_path / "drives" / "d.csv"
    protocol_in(tmp_path, drive=0.9 * RISE)
    assert main(["run", "--resume", str(run), str(path)]) == 2
    assert "error[resume-mismatch]" in capsys.readouterr().err
    drive_file.unlink()
    assert main(["run", "--resume", str(run), str(path)]) == 2
    assert "error[file-missing]" in capsys.readouterr().err
    assert main(["run", "--resume", str(run)]) == 0
    assert [s.condition for s in Run(run).sweeps()] == ["followed", "0-40"]
    assert plan_of_the_past(Run(run)).hash == plan.hash  # what 'replay' begins with
