"""`piezo-rig replay`: the drivers against the record of a run, without any instrument."""

from __future__ import annotations

import shutil
import struct
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from piezo_rig.cli import main

sys.path.insert(0, str(Path(__file__).parents[1] / "run_file"))
from short_run import played

HEAD = struct.Struct("<dBBI")


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    return played(tmp_path_factory.mktemp("whole"))


@pytest.fixture
def no_instruments(monkeypatch):
    forbid_lines(monkeypatch)


def forbid_lines(monkeypatch) -> None:
    """No line may be opened from now on."""

    def refuse(*args, **options):
        raise AssertionError("a replay opened a line")

    monkeypatch.setattr("drivers.transport.VisaTransport._open", refuse)
    monkeypatch.setattr("drivers.transport.SerialTransport._open", refuse)


def transcript_of(path: Path) -> list[tuple[float, int, int, bytes]]:
    """Every record, as docs/run-file.md describes them."""
    with h5py.File(path) as f:
        data = f["entry/wire_transcript"][...].tobytes()
    found, at = [], 0
    while at < len(data):
        time_s, instrument, direction, length = HEAD.unpack_from(data, at)
        at += HEAD.size
        found.append((time_s, instrument, direction, data[at : at + length]))
        at += length
    return found


def with_transcript(path: Path, new: Path, records) -> Path:
    shutil.copy(path, new)
    data = b"".join(HEAD.pack(t, i, d, len(b)) + b for t, i, d, b in records)
    with h5py.File(new, "r+") as f:
        del f["entry/wire_transcript"]
        f["entry/wire_transcript"] = np.frombuffer(data, dtype=np.uint8)
    return new


def test_the_same_drivers_say_the_same(whole, capsys, no_instruments):
    sent = sum(direction == 0 for _, _, direction, _ in transcript_of(whole))
    assert main(["replay", str(whole)]) == 0
    assert f"all {sent} exchanges are the same" in capsys.readouterr().out


def test_a_run_of_an_early_version_is_replayed_too(whole, tmp_path, capsys, no_instruments):
    path = Path(shutil.copy(whole, tmp_path / "old.h5"))
    with h5py.File(path, "r+") as f:
        del f["entry/calibration_texts"]
    assert main(["replay", str(path)]) == 0


def test_a_driver_that_sends_something_else_is_shown_where(
    whole, capsys, no_instruments, monkeypatch
):
    from drivers.waveform_dac import Keysight33500B

    monkeypatch.setattr(Keysight33500B, "start", lambda self: self._link.command("TRIG1"))
    assert main(["replay", str(whole)]) == 1
    said = capsys.readouterr().out
    assert "DIFFERS waveform_dac at" in said
    assert "sends 'TRIG1;:SYST:ERR?' where '*TRG;:SYST:ERR?' was sent" in said
    assert said.count("DIFFERS") == 6  # once for every sweep


def test_a_driver_that_sends_less_is_shown(whole, capsys, no_instruments, monkeypatch):
    from drivers.digitizer import KeysightL4532A

    monkeypatch.setattr(KeysightL4532A, "arm", lambda self: None)
    assert main(["replay", str(whole)]) == 1
    assert "digitizer at" in (said := capsys.readouterr().out)
    assert "no longer sends 'ABOR;:INIT;:SYST:ERR?'" in said


def test_a_driver_that_sends_more_is_shown(whole, capsys, no_instruments, monkeypatch):
    from drivers.digitizer import KeysightL4532A

    arm = KeysightL4532A.arm

    def arm_twice(self):
        self._link.command("STAT:PRES")
        arm(self)

    monkeypatch.setattr(KeysightL4532A, "arm", arm_twice)
    assert main(["replay", str(whole)]) == 1
    assert "sends 'STAT:PRES;:SYST:ERR?'" in capsys.readouterr().out


def test_a_driver_that_reads_other_volts_is_shown(whole, capsys, no_instruments, monkeypatch):
    from drivers.digitizer import KeysightL4532A

    fetch = KeysightL4532A.fetch

    def doubled(self, channels, count, **options):
        return {c: 2 * v for c, v in fetch(self, channels, count, **options).items()}

    monkeypatch.setattr(KeysightL4532A, "fetch", doubled)
    assert main(["replay", str(whole)]) == 1
    assert "sweep_0001: sensor_v comes out otherwise" in capsys.readouterr().out


def test_an_answer_that_was_other_then_makes_the_drivers_fail_now(
    whole, tmp_path, capsys, no_instruments
):
    records = transcript_of(whole)
    last = max(i for i, (_, which, d, _) in enumerate(records) if which == 0 and d == 1)
    records[last] = (*records[last][:3], b'-222,"Data out of range"\n')
    path = with_transcript(whole, tmp_path / "r.h5", records)
    assert main(["replay", str(path)]) == 1
    assert "DIFFERS" in capsys.readouterr().out


def failed_run(folder: Path, fault: dict) -> Path:
    """A run in which the digitizer fails before the third sweep."""
    from dataclasses import replace

    import short_run

    from drivers.clock import VirtualClock
    from drivers.simulated.bench import SimulatedBench
    from drivers.simulated.plant import Plant
    from piezo_rig.bench import open_bench
    from piezo_rig.config import load_rig
    from piezo_rig.errors import BenchError
    from piezo_rig.protocol import build_plan, load_protocol
    from piezo_rig.runner import Wire, play

    (folder / "short.toml").write_text(short_run.PROTOCOL)
    clock, faults, told, wire = VirtualClock(), {"digitizer": {}}, [], Wire()
    with SimulatedBench(Plant(), clock, faults=faults) as served:
        (folder / "rig.toml").write_text(short_run.RIG.replace(
            "[digitizer]", "[digitizer]\ntimeout_s = 0.3"
        ))
        rig, where = load_rig(str(folder / "rig.toml")), served.addresses
        rig = replace(
            rig, simulated=False,
            waveform_dac=replace(rig.waveform_dac, address=where["waveform_dac"]),
            amplifier=replace(rig.amplifier, address=where["amplifier"]),
            digitizer=replace(
                rig.digitizer, link=replace(rig.digitizer.link, address=where["digitizer"])
            ),
        )
        with open_bench(rig, lambda question: True, wire, clock) as bench:
            plan = build_plan(load_protocol(folder / "short.toml"), rig)

            def tell(text):
                told.append(text)
                if len(told) == 3:
                    faults["digitizer"].update(fault)

            with pytest.raises(BenchError):
                play(plan, bench, folder / "r.h5", wire, tell)
    return folder / "r.h5"


@pytest.mark.parametrize("fault", [{"no_trigger": True}, {"hang_up": True}])
def test_a_field_report_of_a_failure_fails_in_the_same_way(
    tmp_path, capsys, monkeypatch, fault
):
    path = failed_run(tmp_path, fault)
    forbid_lines(monkeypatch)
    assert main(["replay", str(path)]) == 0, capsys.readouterr().out
    assert "exchanges are the same" in capsys.readouterr().out


def test_a_run_that_was_stopped_is_replayed_to_where_it_stopped(
    tmp_path, capsys, monkeypatch
):
    from piezo_rig.errors import Aborted

    def stop_at_third(text):
        if text.startswith("sweep 3"):
            raise Aborted("aborted", "stopped by SIGINT")

    with pytest.raises(Aborted):
        played(tmp_path, tell=stop_at_third)
    forbid_lines(monkeypatch)
    assert main(["replay", str(tmp_path / "r.h5")]) == 0, capsys.readouterr().out


def test_a_transcript_that_breaks_off_is_compared_as_far_as_it_goes(
    whole, tmp_path, capsys, no_instruments
):
    records = transcript_of(whole)
    path = with_transcript(whole, tmp_path / "r.h5", records[: len(records) * 2 // 3])
    with h5py.File(path, "r+") as f:  # killed: nothing of an end is in the log
        lines = f["entry/event_log"][...].tobytes().splitlines(keepends=True)
        kept = b"".join(line for line in lines if b"finished" not in line)
        del f["entry/event_log"]
        f["entry/event_log"] = np.frombuffer(kept, dtype=np.uint8)
    assert main(["replay", str(path)]) == 0
    assert "breaks off" in capsys.readouterr().out


DAMAGE = {
    "empty": lambda data: data[:0],
    "cut": lambda data: data[:-5],
    "a header of nothing": lambda data: np.concatenate([np.full(14, 255, np.uint8), data]),
    "an endless record": lambda data: np.concatenate(
        [np.frombuffer(HEAD.pack(0.0, 0, 0, 4_000_000_000), np.uint8), data]
    ),
    "the beginning lost": lambda data: data[len(HEAD.pack(0, 0, 0, 0)) + 40 :],
}  # fmt: skip


@pytest.mark.parametrize("name", list(DAMAGE))
def test_a_damaged_transcript_is_one_clear_error(
    whole, tmp_path, capsys, no_instruments, name
):
    path = Path(shutil.copy(whole, tmp_path / "r.h5"))
    with h5py.File(path, "r+") as f:
        data = DAMAGE[name](f["entry/wire_transcript"][...])
        del f["entry/wire_transcript"]
        f["entry/wire_transcript"] = data
    assert main(["replay", str(path)]) == 2
    assert capsys.readouterr().err.startswith("error[transcript]: ")


def test_an_imported_run_has_nothing_to_replay(tmp_path, capsys):
    (tmp_path / "a.csv").write_text("time_s,drive_v,displacement_um\n0,0,0\n1,1,1\n2,0,0\n")
    run = tmp_path / "a.h5"
    assert main(["import", str(tmp_path / "a.csv"), "--out", str(run)]) == 0
    assert main(["replay", str(run)]) == 2
    assert capsys.readouterr().err.startswith("error[transcript]: ")
