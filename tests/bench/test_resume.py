"""A run that was broken off is gone on with in a new process; a bad condition is played again."""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pytest

from piezo_rig.bench import open_bench
from piezo_rig.cli import main
from piezo_rig.commands.data_options import load_data
from piezo_rig.config import load_rig
from piezo_rig.errors import BenchError
from piezo_rig.protocol import build_plan, load_protocol
from piezo_rig.resources import shipped_folder
from piezo_rig.run_file.close import recover
from piezo_rig.run_file.reader import Run
from piezo_rig.run_file.verify import verify
from piezo_rig.runner import Wire, play

VIRGIN = """
schema = "piezo-rig/protocol/1"
name = "two"
repeats = 2
[[condition]]
waveform = "triangle"
lower_v = 0
upper_v = [65, 75]
frequency_hz = 10
cycles = 2
"""
CARRIED = VIRGIN.replace('repeats', 'history = "carried"\nrepeats')
RIG = (shipped_folder("configs") / "simulated_bench.toml").read_text()


def broken(folder: Path, text: str, sweeps: int) -> Path:
    """A run whose digitizer failed after so many sweeps, of four."""
    protocol = folder / "two.toml"
    protocol.write_text(text)
    rig = load_rig()
    plan = build_plan(load_protocol(protocol), rig)
    left = sweeps

    def tell(line: str) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            raise BenchError("instrument-timeout", "digitizer: did not answer")

    wire = Wire()
    with suppress(BenchError), open_bench(rig, lambda question: True, wire) as bench:
        play(plan, bench, folder / "r.h5", wire, tell)
    return folder / "r.h5"


def identities(run: Run) -> list[tuple[str, int]]:
    return [(s.condition, s.repeat) for s in run.sweeps()]


def test_what_is_missing_is_played_and_the_seam_is_marked(tmp_path, capsys):
    path = broken(tmp_path, VIRGIN, 1)
    before = Run(path).sweeps()[0]
    assert main(["run", "--resume", str(path)]) == 0
    assert [line.split(": ")[0] for line in capsys.readouterr().out.splitlines()[-3:]] == [
        "run", "model", "figure",
    ]
    run = Run(path)
    assert identities(run) == [("0-65", 1), ("0-75", 1), ("0-65", 2), ("0-75", 2)]
    assert run.complete
    assert verify(path)[1] == []
    sweeps = run.sweeps()
    np.testing.assert_array_equal(sweeps[0].sensor_v, before.sensor_v)
    assert [s.history for s in sweeps] == ["virgin"] * 4  # the runner waits before each
    pauses = [s.resumed_after_s for s in sweeps]
    assert pauses[0] is None
    assert pauses[2:] == [None, None]
    end = sweeps[0].start_time + sweeps[0].samples / sweeps[0].sample_rate
    assert pauses[1] == pytest.approx(sweeps[1].start_time - end)
    assert pauses[1] >= load_rig().recovery_s
    assert [e["event"] for e in run.events()].count("resumed") == 1
    assert main(["run", "--resume", str(path)]) == 0
    assert "lacks nothing" in capsys.readouterr().out


def test_a_sweep_after_the_seam_does_not_claim_the_history_that_the_plan_gave_it(tmp_path):
    path = broken(tmp_path, CARRIED, 2)
    assert main(["run", "--resume", str(path), "--rig", "simulated_bench"]) == 0
    assert [s.history for s in Run(path).sweeps()] == ["virgin", "carried", "unknown", "carried"]


def test_a_condition_that_is_played_again_supersedes_and_keeps_the_old_sweeps(tmp_path, capsys):
    path = broken(tmp_path, CARRIED, 4)
    before = {s.name: s for s in Run(path).sweeps()}
    assert main(["run", "--resume", str(path), "--only", "0-65"]) == 0
    run = Run(path)
    assert run.sweep_names == [f"sweep_{k:04d}" for k in range(1, 7)]
    assert run.active_names == ["sweep_0002", "sweep_0004", "sweep_0005", "sweep_0006"]
    old = run.sweeps(["sweep_0001", "sweep_0003"])
    assert [s.superseded_by for s in old] == ["sweep_0005", "sweep_0006"]
    np.testing.assert_array_equal(old[0].sensor_v, before["sweep_0001"].sensor_v)
    assert run.complete
    # Each followed a sweep that is not among those that count, or was out of its turn.
    assert [s.history for s in run.sweeps()] == ["unknown", "unknown", "virgin", "unknown"]
    with h5py.File(path) as f:
        assert f["entry/loop"].attrs["sweep"] == "sweep_0005"
    sweeps, _ = load_data(argparse.Namespace(data=[str(path)], mixed_origin=False))
    assert [s.name for s in sweeps] == run.active_names
    capsys.readouterr()
    assert main(["show", str(path)]) == 0
    assert "sweep_0001  superseded by sweep_0005" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (("sensitivity = 3 ", "sensitivity = 2 "), "interferometer.sensitivity is 2, was 3"),
        (("rest_slew_v_per_s = 300.0", "rest_slew_v_per_s = 200.0"), "limits.rest_slew_v_per_s"),
        (('serial = "SIM-STACK-1"', 'serial = "other"'), "actuator.serial is other"),
        (("[plant]", "[plant.mains-hum]\non = true"), "plant.mains-hum.on is True"),
    ],
)
def test_another_config_is_refused(tmp_path, capsys, change, word):
    path = broken(tmp_path, VIRGIN, 1)
    other = tmp_path / "other.toml"
    other.write_text(RIG.replace(*change))
    assert main(["run", "--resume", str(path), "--rig", str(other)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error[resume-mismatch]: ")
    assert word in said


def test_another_protocol_and_another_calibration_are_refused(tmp_path, capsys):
    path = broken(tmp_path, VIRGIN, 1)
    protocol = tmp_path / "other.toml"
    protocol.write_text(VIRGIN.replace("cycles = 2", "cycles = 3"))
    assert main(["run", str(protocol), "--resume", str(path)]) == 2
    assert "plan " in capsys.readouterr().err
    calibration = (shipped_folder("calibration") / "amplifier.toml").read_text()
    (tmp_path / "amplifier.toml").write_text(calibration + "\n# measured again\n")
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG.replace('"amplifier"', '"amplifier.toml"'))
    assert main(["run", "--resume", str(path), "--rig", str(rig)]) == 2
    assert "calibration" in capsys.readouterr().err


def test_other_instruments_are_refused_before_anything_moves(tmp_path, capsys):
    path = broken(tmp_path, VIRGIN, 1)
    with h5py.File(path, "r+") as f:
        f["entry/instrument/digitizer"].attrs["serial"] = "SIM77777"
    assert main(["run", "--resume", str(path)]) == 3
    said = capsys.readouterr().err
    assert said.startswith("error[resume-instruments]: ")
    assert "had SIM77777" in said
    assert "not touched" in said


def test_a_condition_that_the_run_does_not_hold_is_named(tmp_path, capsys):
    path = broken(tmp_path, VIRGIN, 1)
    assert main(["run", "--resume", str(path), "--only", "0-70"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error[resume-condition]: ")
    assert "0-65" in said


DIES = """
import os, signal, sys
from piezo_rig.cli import main
from piezo_rig.runner.play import _Session
plain = _Session._play
def once(self, index, sweep):
    plain(self, index, sweep)
    os.kill(os.getpid(), signal.SIGKILL)
_Session._play = once
main(["run", "--resume", sys.argv[1]])
"""


def killed_while_resuming(path: Path) -> Path:
    """A process goes on with the run and dies after the first sweep that it stored."""
    done = subprocess.run([sys.executable, "-c", DIES, str(path)], capture_output=True)
    assert done.returncode == -signal.SIGKILL, done.stderr
    return path.with_name("r.part.h5")


def test_a_resumed_run_that_is_killed_is_joined_at_the_next_start(tmp_path):
    path = broken(tmp_path, VIRGIN, 1)
    part = killed_while_resuming(path)
    assert len(Run(path).sweep_names) == 1  # untouched so far
    kept = part.read_bytes()
    assert recover(tmp_path) == [path]
    assert identities(Run(path)) == [("0-65", 1), ("0-75", 1)]
    assert not part.exists()
    part.write_bytes(kept)  # killed again, between joining and removing the part
    recover(tmp_path)
    assert len(Run(path).sweep_names) == 2
    assert not part.exists()
    assert main(["run", "--resume", str(part)]) == 0  # a part stands for its run
    assert Run(path).complete
    assert verify(path)[1] == []


def test_a_run_goes_on_in_another_folder_if_asked(tmp_path):
    path = broken(tmp_path, VIRGIN, 3)
    there = tmp_path / "there"
    assert main(["run", "--resume", str(path), "--out", str(there)]) == 0
    assert Run(there / "r.h5").complete
    assert not Run(path).complete
