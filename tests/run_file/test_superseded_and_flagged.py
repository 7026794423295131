"""What `verify` makes of sweeps that were played again, and of flags in a run's log."""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from short_run import played

from piezo_rig.cli import main
from piezo_rig.commands.data_options import load_data
from piezo_rig.run_file.verify import usable, verify


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """Six sweeps: 0-40 and 0-75 V in turn, three repeats; then both first ones played again."""
    folder = tmp_path_factory.mktemp("whole")
    path = played(folder)
    again = ["run", "--resume", str(path), "--rig", str(folder / "rig.toml"), "--only", "0-40"]
    assert main(again) == 0
    return path


@pytest.fixture
def changed(whole, tmp_path):
    """A function: what to do to the open run -> the changed copy."""

    def change(how) -> Path:
        path = tmp_path / "changed.h5"
        shutil.copy(whole, path)
        with h5py.File(path, "r+") as f:
            how(f["entry"])
        return path

    return change


OLD, NEW = ["sweep_0001", "sweep_0003", "sweep_0005"], ["sweep_0007", "sweep_0008", "sweep_0009"]
REST = ["sweep_0002", "sweep_0004", "sweep_0006"]


def spoil(sweep: str, from_sample: int = 0):
    def how(entry) -> None:
        values = entry[sweep]["sensor_v"][...]
        values[from_sample:] = values[from_sample]
        entry[sweep]["sensor_v"][...] = values

    return how


def test_a_run_with_superseded_sweeps_verifies_clean(whole, capsys):
    assert verify(whole)[1] == []
    assert main(["verify", str(whole)]) == 0
    said = capsys.readouterr().out
    assert "6 of 6 sweeps may be used; no faults" in said
    assert "sweep_0001: superseded by sweep_0007, not counted" in said


def test_a_fault_of_a_superseded_sweep_is_a_note(changed, capsys):
    path = changed(spoil("sweep_0003", 100))
    _, found = verify(path)
    assert found
    assert {(v.sweep, v.fault) for v in found} == {("sweep_0003", False)}
    assert all(v.text.startswith("superseded by sweep_0008; ") for v in found)
    assert usable(path) == {*NEW, *REST}
    assert main(["verify", str(path)]) == 0
    assert "6 of 6 sweeps may be used; no faults" in capsys.readouterr().out


def test_superseded_sweeps_do_not_vote_on_those_that_count(changed):
    """Three old ones of another sensitivity would outvote one of the new ones."""

    def how(entry) -> None:
        for name in OLD:
            volts = entry[name]["sensor_v"][...]
            entry[name]["sensor_v"][...] = volts[0] + 1.3 * (volts - volts[0])

    _, found = verify(changed(how))
    assert {v.sweep for v in found if v.fault} == set()


def test_a_sweep_that_counts_and_is_faulty_is_still_a_fault(changed, capsys):
    path = changed(spoil("sweep_0008", 100))
    assert main(["verify", str(path)]) == 1
    assert "5 of 6 sweeps may be used" in capsys.readouterr().out


@pytest.mark.parametrize("by", ["sweep_0099", "sweep_0002", ""])
def test_a_sweep_gives_way_only_to_its_own_kind(changed, capsys, by):
    path = changed(lambda entry: entry["sweep_0004"].attrs.__setitem__("superseded_by", by))
    assert main(["verify", str(path)]) == 1
    assert "FAULT run: sweep_0004 says that" in capsys.readouterr().out
    assert "sweep_0004" in usable(path)  # it is not hidden by a claim that is none


def test_a_sweep_that_names_another_condition_is_found_out(changed, capsys):
    path = changed(
        lambda entry: entry["sweep_0004"].attrs.__setitem__("superseded_by", "sweep_0007")
    )
    assert main(["verify", str(path)]) == 1
    assert "which is of 0-40, repeat 1" in capsys.readouterr().out


def test_show_and_the_data_of_identify_skip_what_is_superseded(changed, capsys):
    path = changed(spoil("sweep_0003", 100))
    args = argparse.Namespace(data=[str(path)], mixed_origin=False)
    sweeps, _ = load_data(args)
    assert [s.name for s in sweeps] == [*REST, *NEW]
    said = capsys.readouterr().out
    assert "left out" not in said
    assert main(["show", str(path)]) == 0
    said = capsys.readouterr().out
    assert "sweep_0003  superseded by sweep_0008" in said
    assert "sweep_0003  0-40" not in said
    assert "sweep_0007  0-40" in said


@pytest.mark.parametrize("value", ["long", np.nan, True])
def test_a_pause_that_is_no_number_is_damage_and_no_crash(changed, capsys, value):
    path = changed(lambda entry: entry["sweep_0007"].attrs.__setitem__("resumed_after_s", value))
    assert main(["verify", str(path)]) == 1
    assert "FAULT sweep_0007: resumed_after_s is" in capsys.readouterr().out
    assert main(["show", str(path)]) == 0


def flagged(sweep: str, code: str, usable: bool = False):
    """Adds a flag to the log, as the runner writes it."""

    def how(entry) -> None:
        event = {"time_s": 1e6, "event": "flag", "code": code, "sweep": sweep,
                 "what": "told then\x1b[2J", "first": 3, "count": 50, "usable": usable}
        line = np.frombuffer((json.dumps(event) + "\n").encode(), np.uint8)
        log = np.concatenate([entry["event_log"][...], line, line])
        del entry["event_log"]
        entry["event_log"] = log

    return how


def lines(path: Path, capsys) -> list[str]:
    main(["verify", str(path)])
    said = capsys.readouterr().out
    assert "\x1b" not in said
    return [line for line in said.splitlines() if line.startswith(("FAULT", "note"))]


@pytest.mark.parametrize("code", ["beam-interruption", "sensor-clipping", "sensor-sensitivity"])
def test_a_flag_that_the_samples_do_not_show_is_a_fault_of_its_sweep(changed, capsys, code):
    (line,) = lines(changed(flagged("sweep_0002", code)), capsys)
    assert line.startswith(f"FAULT sweep_0002: flagged when it was played: {code}: told then")
    assert "diagnose" not in line


@pytest.mark.parametrize(("code", "usable"), [("drive-clipping", False), ("sensor-clipping", True)])
def test_a_flag_whose_cause_diagnosis_knows_keeps_the_sweep_for_it(changed, capsys, code, usable):
    path = changed(flagged("sweep_0002", code, usable))
    (line,) = lines(path, capsys)
    assert line.endswith(f"(may be used by diagnose only: {code})")
    args = argparse.Namespace(data=[str(path)], mixed_origin=False)
    assert "sweep_0002" not in [s.name for s in load_data(args)[0]]
    assert "sweep_0002" in [s.name for s in load_data(args, for_diagnosis=True)[0]]


def test_a_flag_that_the_samples_show_as_well_is_told_once(changed, capsys):
    def how(entry) -> None:
        spoil("sweep_0002")(entry)
        flagged("sweep_0002", "beam-interruption")(entry)

    (line,) = [x for x in lines(changed(how), capsys) if "sweep_0002" in x and "FAULT s" in x]
    assert "one value throughout" in line
    assert line.count("beam-interruption") == 1


def test_flags_of_superseded_sweeps_and_of_none_are_no_faults(changed, capsys):
    (line,) = lines(changed(flagged("sweep_0001", "beam-interruption")), capsys)
    assert line.startswith("note  sweep_0001: superseded by sweep_0007; flagged")
    assert lines(changed(flagged("sweep_0042", "beam-interruption")), capsys) == []


@pytest.mark.parametrize(
    ("plant", "code", "only_diagnose"),
    [
        ("[plant.drive_clipping]\non = true\nupper = 60", "drive-clipping", True),
        ("[plant.sensor_clipping]\non = true\nlevel = 2.0", "sensor-clipping", True),
    ],
)  # fmt: skip
def test_a_faulty_bench_is_named_once_for_every_sweep(tmp_path, capsys, plant, code, only_diagnose):
    path = played(tmp_path, f"\n{plant}\n")
    found = [x for x in lines(path, capsys) if x.startswith("FAULT sweep")]
    assert found
    sweeps = [x.split()[1] for x in found]
    assert len(set(sweeps)) == len(sweeps), found
    assert all(code in x for x in found)
    assert all(x.endswith(f"diagnose only: {code})") for x in found) == only_diagnose
