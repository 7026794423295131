"""What `verify` finds in runs that somebody else broke, and which sweeps it lets be used."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from short_run import played

from piezo_rig.cli import main
from piezo_rig.run_file.verify import usable, verify
from piezo_rig.run_file.verify.monitor import followed
from piezo_rig.run_file.verify.sweep_checks import Channels

ALL = {f"sweep_{i:04d}" for i in range(1, 7)}


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    return played(tmp_path_factory.mktemp("whole"))


@pytest.fixture
def broken(whole, tmp_path):
    """A function: what to do to the open file -> the broken copy."""

    def break_it(how) -> Path:
        path = tmp_path / "broken.h5"
        shutil.copy(whole, path)
        with h5py.File(path, "r+") as f:
            how(f["entry"])
        return path

    return break_it


def test_a_whole_run_is_all_usable(whole, capsys):
    assert main(["verify", str(whole)]) == 0
    said = capsys.readouterr().out
    assert "6 of 6 sweeps may be used; no faults" in said
    assert said.count("may be used\n") == 6


def replaced(group: h5py.Group, name: str, values, units: str = "V") -> None:
    del group[name]
    group[name] = values
    group[name].attrs["units"] = units


def attribute(name, value):
    return lambda g: g.attrs.__setitem__(name, value)


def row(name, change):
    return lambda g: g[name].__setitem__(..., change(g[name][...]))


def shifted(values, count=40, at=300):
    return np.concatenate([values[:at], values[at + count :], values[-count:][::-1]])


BREAKS = {
    "gain": (attribute("gain", 7.6), "gain is 7.6"),
    "gain of nothing": (attribute("gain", 0.0), "gain is 0"),
    "offset": (attribute("offset_v", 74.0), "offset_v is 74"),
    "sensitivity": (attribute("sensitivity_um_per_v", 3.87), "sensitivity_um_per_v is 3.87"),
    "polarity": (attribute("polarity", 1), "polarity"),
    "polarity of two": (attribute("polarity", 2), "polarity is"),
    "zero": (attribute("zero_v", 0.01), "zero_v is 0.01"),
    "rate": (attribute("sample_rate", 5000.0), "sample_rate is 5000"),
    "origin": (attribute("origin", "REAL"), "origin REAL"),
    "origin of nowhere": (attribute("origin", "MARS"), "origin is 'MARS'"),
    "condition": (attribute("condition", "0-75"), "the event log says"),
    "repeat": (attribute("repeat", 7), "the event log says"),
    "history": (attribute("history", "forgotten"), "history is 'forgotten'"),
    "start": (attribute("start_time", 1e9), "starts at 1e+09"),
    "earlier start": (attribute("start_time", 0.5), "starts at 0.5 s"),
    "text for a number": (attribute("gain", "seven"), "gain is 'seven'"),
    "a list for a number": (attribute("gain", [7.5, 7.5]), "lacks gain"),
    "attribute lost": (lambda g: g.attrs.__delitem__("zero_v"), "lacks zero_v"),
    "units": (lambda g: g["sensor_v"].attrs.__setitem__("units", "mV"), "'mV', not in V"),
    "no units": (lambda g: g["command_v"].attrs.__delitem__("units"), "not in V"),
    "channel lost": (lambda g: g.__delitem__("sensor_v"), "sensor_v is missing"),
    "monitor lost": (lambda g: g.__delitem__("drive_monitor_v"), "drive_monitor_v is missing"),
    "NaN": (lambda g: g["sensor_v"].__setitem__(slice(7, 9), np.nan), "2 values missing"),
    "inf": (lambda g: g["drive_monitor_v"].__setitem__(3, np.inf), "first at sample 3"),
    "huge": (lambda g: g["sensor_v"].__setitem__(3, 3e9), "cannot go beyond"),
    "command too high": (lambda g: g["command_v"].__setitem__(5, 0.5), "cannot go beyond"),
    "shorter": (lambda g: replaced(g, "sensor_v", g["sensor_v"][:-1]), "has 999 samples"),
    "empty": (lambda g: replaced(g, "sensor_v", np.zeros(0)), "has 0 samples"),
    "a table": (lambda g: replaced(g, "sensor_v", np.zeros((10, 100))), "not one row"),
    "words": (lambda g: replaced(g, "sensor_v", np.array([b"x"] * 1000)), "not numbers"),
    "stuck sensor": (row("sensor_v", lambda v: 0 * v + v[0]), "one value throughout"),
    "noise only": (
        row("sensor_v", lambda v: v[0] + np.where(np.arange(v.size) % 2, 1e-3, 0)
            * (np.arange(v.size) > 0)),
        "does not follow the drive",
    ),
    "swapped rows": (row("sensor_v", lambda v: -v), "polarity -1 is wrong"),
    "saturated": (row("sensor_v", lambda v: np.maximum(v, 0.6 * v.min())), "saturated"),
    "command moved": (row("command_v", lambda v: v + np.where(v > -9, 0.3, 0)), "goes up to"),
    "monitor hit": (
        lambda g: g["drive_monitor_v"].__setitem__(slice(100, 130), 60.0), "drive monitor reads",
    ),
    "monitor scaled": (row("drive_monitor_v", lambda v: 1.05 * v), "drive monitor reads"),
    "other sensitivity": (
        row("sensor_v", lambda v: v[0] + 1.15 * (v - v[0])), "differs from its repeats",
    ),
    "rolled": (
        row("sensor_v", lambda v: np.concatenate([v[:1], np.roll(v[1:], 25)])), "its repeats",
    ),
    "a piece of another place": (
        row("sensor_v", lambda v: np.concatenate([v[:200], v[450:550], v[300:]])), "its repeats",
    ),
    "a piece filled in": (
        lambda g: g["sensor_v"].__setitem__(slice(300, 380), 0.5 * float(g["sensor_v"][250])),
        "stands still for 80 samples from sample 300",
    ),
    "a group for a row": (
        lambda g: (g.__delitem__("sensor_v"), g.create_group("sensor_v")), "is a group",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", list(BREAKS))
def test_one_broken_sweep_is_named_and_the_others_may_be_used(broken, capsys, name):
    how, words = BREAKS[name]
    path = broken(lambda entry: how(entry["sweep_0003"]))
    assert main(["verify", str(path)]) == 1
    said = [line for line in capsys.readouterr().out.splitlines() if line.startswith("FAULT")]
    assert any("sweep_0003" in line and words in line for line in said), said
    assert usable(path) == ALL - {"sweep_0003"}


RUN_BREAKS = {
    "a sweep lost": (lambda e: e.__delitem__("sweep_0004"), "missing: sweep_0004"),
    "protocol lost": (lambda e: e.__delitem__("protocol_text"), "protocol_text is missing"),
    "log cut": (
        lambda e: e["event_log"].__setitem__(slice(-20, None), 0), "event_log",
    ),
    "transcript cut": (
        lambda e: e["wire_transcript"].resize((e["wire_transcript"].size - 3,)), "ends inside",
    ),
    "calibration changed": (
        lambda e: e["calibration_texts"].__setitem__(
            (), e["calibration_texts"][()].replace(b"offset_v = 75.0", b"offset_v = 70.0")
        ),
        "not the one whose hash",
    ),
    "plot changed": (
        lambda e: e["loop/displacement"].__setitem__(slice(3, 9), 5.0), "does not show",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", list(RUN_BREAKS))
def test_what_is_wrong_with_the_run_is_said(broken, capsys, name):
    how, words = RUN_BREAKS[name]
    assert main(["verify", str(broken(how))]) == 1
    said = capsys.readouterr().out
    assert any("FAULT run" in line and words in line for line in said.splitlines()), said


def test_samples_that_are_missing_are_for_diagnose_only(broken, capsys):
    def lose(entry):
        for name in ("sensor_v", "drive_monitor_v"):
            row(name, shifted)(entry["sweep_0004"])

    path = broken(lose)
    (fault,) = [v for v in verify(path)[1] if v.fault]
    assert (fault.sweep, fault.cause) == ("sweep_0004", "dropped-samples")
    assert "40 samples" in fault.text or "39 samples" in fault.text  # it lags by up to one


@pytest.mark.parametrize(
    ("plant", "cause"),
    [
        ("[plant.drive_clipping]\non = true\nupper = 60.0\n", "drive-clipping"),
        ("[plant.slew_limit]\non = true\nlimit = 250.0\n", "slew-limit"),
    ],
)
def test_an_amplifier_that_cannot_follow_is_a_cause_not_damage(tmp_path, plant, cause, capsys):
    path = played(tmp_path, plant)
    faults = [v for v in verify(path)[1] if v.fault]
    assert {v.cause for v in faults} == {cause}
    # what the amplifier can do is 60 V, or 250 V/s: the sweeps to 40 V ask for 320 V/s
    hit = {"sweep_0002", "sweep_0004", "sweep_0006"} if cause == "drive-clipping" else ALL
    assert {v.sweep for v in faults} == hit
    out = tmp_path / "m.json"
    status = main(["identify", str(path), "--model", "classical", "--elements", "5",
                   "--out", str(out)])
    said = capsys.readouterr()
    assert said.out.count("is left out") == len(hit)
    assert status == (2 if hit == ALL else 0)
    if hit == ALL:
        assert said.err.startswith("error[no-data]: ")


def test_an_amplifier_far_too_slow_is_a_slew_limit_in_a_noisy_coarse_monitor():
    rate, limit, step_v = 5000.0, 280.0, 1.0 / 256.0  # 75 V at 4 Hz ask for 600 V/s
    half = np.linspace(0.0, 75.0, 626)
    drive = np.append(np.tile(np.concatenate([half[:-1], half[:0:-1]]), 4), 0.0)
    stack = [0.0]
    for v in drive[1:]:
        stack.append(stack[-1] + min(max(v - stack[-1], -limit / rate), limit / rate))
    noisy = np.array(stack) + 2e-3 * np.random.default_rng(3).standard_normal(drive.size)
    monitor = np.round(noisy / step_v) * step_v
    found = followed(
        {"gain": 7.5, "offset_v": 75.0, "oversampling": 1},
        Channels((drive - 75.0) / 7.5, np.zeros(drive.size), monitor, None),
    )
    assert found.law == "slew"
    assert found.limit * rate == pytest.approx(limit, rel=0.005)


def test_a_gain_that_is_wrong_everywhere_is_said_of_the_run(tmp_path):
    path = played(tmp_path, "[plant.drive_gain]\non = true\nratio = 1.03\n")
    faults = [v for v in verify(path)[1] if v.fault]
    assert [v.sweep for v in faults] == [""]
    assert "6 of 6" in faults[0].text
    measured = float(re.search(r"follows ([\d.]+) x drive", faults[0].text).group(1))
    assert measured == pytest.approx(1.03, abs=0.001)
    assert usable(path) == ALL


def test_identify_leaves_out_what_may_not_be_used(broken, tmp_path, capsys):
    path = broken(lambda entry: attribute("gain", 7.6)(entry["sweep_0001"]))
    out = tmp_path / "m.json"
    assert main(["identify", str(path), "--model", "classical", "--elements", "5",
                 "--out", str(out)]) == 0
    assert "sweep_0001 is left out: gain is 7.6" in capsys.readouterr().out
    assert len(json.loads(out.read_text())["provenance"]["sweeps"]) == 5


@pytest.mark.parametrize("verb", ["identify", "diagnose"])
def test_a_run_without_a_usable_sweep_is_one_clear_error(broken, tmp_path, capsys, verb):
    def all_bad(entry):
        for name in ALL:
            attribute("polarity", 1)(entry[name])

    words = {"identify": ["--model", "classical", "--out", str(tmp_path / "m.json")],
             "diagnose": []}[verb]
    assert main([verb, str(broken(all_bad)), *words]) == 2
    said = capsys.readouterr()
    assert said.err.startswith("error[no-data]: ")
    assert said.out.count("is left out") == 6


def test_a_simulated_run_under_another_name_is_not_used(broken):
    def relabel(entry):
        entry.attrs["origin"] = "REAL"
        for name in ALL:
            entry[name].attrs["origin"] = "REAL"

    assert usable(broken(relabel)) == set()


def test_show_goes_on_past_a_sweep_that_cannot_be_read(broken, capsys):
    path = broken(lambda entry: attribute("gain", "seven")(entry["sweep_0002"]))
    assert main(["show", str(path), "--log"]) == 0
    said = capsys.readouterr().out
    assert "sweep_0002  cannot be read: gain is 'seven'" in said
    assert sum(line.startswith("sweep_000") and " .. " in line for line in said.splitlines()) == 5


def test_show_of_nothing_readable_is_one_error(broken, capsys):
    def all_bad(entry):
        for name in ALL:
            del entry[name]["sensor_v"]

    assert main(["show", str(broken(all_bad))]) == 2
    assert capsys.readouterr().err.startswith("error[run-file]: ")


def test_one_file_that_is_no_run_does_not_hide_the_others(whole, tmp_path, capsys):
    no_run = tmp_path / "no.h5"
    no_run.write_bytes(b"nothing")
    assert main(["verify", str(no_run), str(whole)]) == 2
    said = capsys.readouterr()
    assert said.err.startswith("error[run-file]: ")
    assert "6 of 6" in said.out
