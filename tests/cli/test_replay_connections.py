"""`piezo-rig replay` of runs that were connected more than once, flagged, or lost their guard."""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.simulated.bench import SimulatedBench
from drivers.simulated.plant import Plant
from piezo_rig.bench import open_bench
from piezo_rig.cli import main
from piezo_rig.config import load_rig
from piezo_rig.errors import BenchError
from piezo_rig.protocol import build_plan, load_protocol
from piezo_rig.replay.tape import ReplayClock
from piezo_rig.run_file.reader import Run
from piezo_rig.runner import Wire, play

sys.path.insert(0, str(Path(__file__).parents[1] / "run_file"))
import short_run
from test_replay import HEAD, forbid_lines, transcript_of, with_transcript


def broken_off(folder: Path, sweeps: int) -> Path:
    left = sweeps

    def tell(text: str) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            raise BenchError("disk-full", "the disk is full")

    with suppress(BenchError):
        short_run.played(folder, tell=tell)
    return folder / "r.h5"


def gone_on_with(path: Path, *more: str) -> Path:
    rig = path.with_name("rig.toml")
    assert main(["run", "--resume", str(path), "--rig", str(rig), *more]) == 0
    return path


@pytest.fixture(scope="module")
def resumed(tmp_path_factory) -> Path:
    """Two sweeps, a full disk, the other four; then one condition again."""
    path = gone_on_with(broken_off(tmp_path_factory.mktemp("resumed"), 2))
    return gone_on_with(path, "--only", "0-40")


def test_a_resumed_run_is_replayed_connection_by_connection(resumed, capsys, monkeypatch):
    forbid_lines(monkeypatch)
    assert main(["replay", str(resumed)]) == 0, capsys.readouterr().out
    sent = sum(direction == 0 for _, _, direction, _ in transcript_of(resumed))
    assert f"all {sent} exchanges are the same" in capsys.readouterr().out


def test_a_driver_that_changed_is_found_in_every_connection(resumed, capsys, monkeypatch):
    from drivers.waveform_dac import Keysight33500B

    monkeypatch.setattr(Keysight33500B, "start", lambda self: self._link.command("TRIG1"))
    assert main(["replay", str(resumed)]) == 1
    said = capsys.readouterr().out
    assert [said.count(f"DIFFERS connection {k}: waveform_dac at") for k in (1, 2, 3)] == [2, 4, 3]


def starts(records) -> list[int]:
    return [i for i, r in enumerate(records) if r[1:3] == (0, 2) and r[3].startswith(b"opened ")]


def test_a_connection_whose_transcript_was_lost_is_said_and_the_rest_compared(
    resumed, tmp_path, capsys, monkeypatch
):
    records = transcript_of(resumed)
    second, third = starts(records)[1:]
    path = with_transcript(resumed, tmp_path / "r.h5", records[:second] + records[third:])
    with h5py.File(path, "r+") as f:  # killed: it never logged an end
        lines = f["entry/event_log"][...].tobytes().splitlines(keepends=True)
        first_end = next(i for i, line in enumerate(lines) if b'"finished"' in line)
        kept = b"".join(lines[:first_end] + lines[first_end + 1 :])
        del f["entry/event_log"]
        f["entry/event_log"] = np.frombuffer(kept, dtype=np.uint8)
    forbid_lines(monkeypatch)
    assert main(["replay", str(path)]) == 0, capsys.readouterr().out
    said = capsys.readouterr().out
    assert "note    connection 2: killed before any of its transcript reached the disk" in said
    assert "connection 3" not in said


def test_a_transcript_that_lacks_a_connection_that_ended_is_damaged(resumed, tmp_path, capsys):
    records = transcript_of(resumed)
    path = with_transcript(resumed, tmp_path / "r.h5", records[: starts(records)[2]])
    assert main(["replay", str(path)]) == 2
    assert capsys.readouterr().err.startswith("error[transcript]: ")
    assert HEAD.size == 14


def test_a_run_that_its_own_flag_stopped_stops_again_and_tells_nobody(
    tmp_path, capfd, monkeypatch
):
    with pytest.raises(BenchError, match="sweep_0002"):
        short_run.played(tmp_path, "\n[plant.switch_turned]\non = true\ntime = 60\nswitch = 5\n")
    forbid_lines(monkeypatch)
    capfd.readouterr()
    assert main(["replay", str(tmp_path / "r.h5")]) == 0, capfd.readouterr().out
    said = capfd.readouterr().out
    assert "flag[" not in said
    assert "stack" not in said  # nothing is moved, and nothing is said to be
    assert len(said.splitlines()) == 1


def test_a_run_whose_guard_was_killed_is_replayed_through_to_its_rest(
    tmp_path, capsys, monkeypatch
):
    (tmp_path / "short.toml").write_text(short_run.PROTOCOL)
    (tmp_path / "rig.toml").write_text(short_run.RIG)
    rig, clock, wire, told = load_rig(str(tmp_path / "rig.toml")), VirtualClock(), Wire(), []
    with SimulatedBench(Plant(), clock) as simulated:
        where = simulated.addresses
        wired = replace(
            rig, simulated=False,
            waveform_dac=replace(rig.waveform_dac, address=where["waveform_dac"]),
            amplifier=replace(rig.amplifier, address=where["amplifier"]),
            digitizer=replace(
                rig.digitizer, link=replace(rig.digitizer.link, address=where["digitizer"])
            ),
        )
        with open_bench(wired, lambda question: True, wire, clock) as bench:

            def tell(text: str) -> None:
                told.append(text)
                if len(told) == 3:
                    os.kill(bench.keeper.pid, signal.SIGKILL)
                    bench.keeper._process.wait(10)

            plan = build_plan(load_protocol(tmp_path / "short.toml"), wired)
            with pytest.raises(BenchError, match="guard process is gone"):
                play(plan, bench, tmp_path / "r.h5", wire, tell)
        assert abs(simulated.plant.stack_v(clock.now() + 0.01)) < 0.01
    path = tmp_path / "r.h5"
    assert len(Run(path).sweep_names) == 2
    assert len(starts(transcript_of(path))) == 2  # the runner opened the line for itself
    forbid_lines(monkeypatch)
    assert main(["replay", str(path)]) == 0, capsys.readouterr().out


def test_the_clock_of_a_replay_says_what_time_it_is_after_a_pause():
    clock = ReplayClock()
    clock.advance_to(2.0)
    assert clock.sleep(0.5) == 2.5
    assert clock.sleep(-1.0) == 2.5
