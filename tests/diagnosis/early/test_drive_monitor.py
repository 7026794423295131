"""The drive monitor: what the amplifier did is read from it, and what it did not is ruled out.

Monitors are made here as physics says, sample by sample, by code that the program does not share.
"""

from __future__ import annotations

import json
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).parent.parent))
from small_bench import RATE, recordings

from piezo_rig.cli import main
from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.early import read_monitor
from piezo_rig.diagnosis.early.monitor import _comes
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification import prepare
from tests.more import first_of

SPEEDS = (("0-30", 0.0, 30.0, 10.0), ("0-75", 0.0, 75.0, 4.0), ("0-60", 0.0, 60.0, 10.0))
STEP_V = 1.0 / 256.0  # of a 16-bit digitizer on its 128 V range
TAU, LIMIT, DELAY = 3e-4, 900.0, 2e-4


def lagging(drive, tau=TAU, fine=50):
    """Behind a resistance and a capacitance, in small steps, straight between samples."""
    y, out = drive[0], [drive[0]]
    for a, b in pairwise(drive):
        for k in range(1, fine + 1):
            middle = a + (b - a) * (k - 0.5) / fine
            y += (middle - y) * (1.0 - np.exp(-1.0 / (fine * RATE * tau)))
        out.append(y)
    return np.array(out)


def held_and_lagging(drive, tau=TAU):
    """As `lagging` behind a generator that holds each sample; seen just before the next one."""
    out, decay = [drive[0]], np.exp(-1.0 / RATE / tau)
    for before in drive[:-1]:
        out.append(before + (out[-1] - before) * decay)
    return np.array(out)


def limited(drive, fine=50, limit=LIMIT):
    """No faster than the amplifier's current allows, in small steps, straight between samples."""
    y, out, most = drive[0], [drive[0]], limit / RATE / fine
    for a, b in pairwise(drive):
        for k in range(1, fine + 1):
            y += min(max(a + (b - a) * k / fine - y, -most), most)
        out.append(y)
    return np.array(out)


def clipped(drive):
    return np.minimum(drive, 58.0)


def late(drive, delay=DELAY):
    t = np.arange(drive.size) / RATE
    return np.interp(t - delay, t, drive)


def white(n, rng):
    return 2e-3 * rng.standard_normal(n)


def red(n, rng):
    out, x = np.empty(n), 0.0
    for i, e in enumerate(rng.standard_normal(n)):
        x = 0.95 * x + 0.3 * 2e-3 * e
        out[i] = x
    return out


def nothing(n, rng):
    return np.zeros(n)


def watched(sweeps, amplifier=lambda v: v, noise=white, step_v=STEP_V, divider=1.003):
    """The sweeps with a monitor of what an amplifier makes of their drive."""
    rng = np.random.default_rng(5)
    known = {s.condition: amplifier(s.drive_v) for s in sweeps}
    out = []
    for s in sweeps:
        volts = 0.02 + divider * known[s.condition] + noise(s.samples, rng)
        out.append(s.with_(drive_monitor_v=np.round(volts / step_v) * step_v))
    return out


@pytest.fixture(scope="module")
def plain():
    return recordings(conditions=SPEEDS)


def read(sweeps):
    groups = group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)
    return read_monitor(groups, sweeps, 0.001, 25)


@pytest.mark.parametrize("noise", [red, nothing])
def test_an_amplifier_that_follows_is_said_to_do_nothing(plain, noise):
    found = read(watched(plain, noise=noise))
    assert found.told == ()
    assert not found.notes
    assert not found.warnings
    assert set(found.bounds) == {"amplifier-lag", "slew-limit", "drive-clipping"}


@pytest.mark.parametrize(
    ("amplifier", "cause", "name", "true"),
    [(held_and_lagging, "amplifier-lag", "tau", TAU),
     (limited, "slew-limit", "limit", LIMIT), (clipped, "drive-clipping", "upper", 58.0)],
)  # fmt: skip
def test_what_the_amplifier_does_is_read_with_its_size(plain, amplifier, cause, name, true):
    told = read(watched(plain, amplifier)).told[0]
    assert told.stage.id == cause
    low, high = told.stage.parameters[name].ci95
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    assert abs(true - middle) < 2.0 * half
    assert half < 0.03 * true
    assert told.p_value < 1e-9


@pytest.mark.parametrize("share", first_of(1, [0.95, 0.935, 0.973]))
def test_a_limit_just_below_the_only_fast_drive_is_found_beside_a_lag(plain, share):
    fastest = 2.0 * 60.0 * 10.0  # the others are half as fast

    def amplifier(drive):
        return lagging(limited(drive, limit=share * fastest), tau=0.2 / RATE)

    told = {t.stage.id: t.stage for t in read(watched(plain, amplifier)).told}
    assert told["slew-limit"]["limit"] == pytest.approx(share * fastest, rel=1e-3)


@pytest.mark.study
def test_two_limits_are_read_together():
    # each alone leaves the other one to gain and offset, which are free
    def between(drive):
        return np.clip(drive, -50.0, 55.0)

    low, high = read(watched(
        recordings(conditions=(("60", -60.0, 60.0),), repeats=1), between
    )).told[0].stage.parameters.values()  # fmt: skip
    assert low.ci95[0] - 0.01 < -50.0 < low.ci95[1] + 0.01
    assert high.ci95[0] - 0.01 < 55.0 < high.ci95[1] + 0.01


def test_a_record_that_begins_late_is_late_and_lags_nowhere(plain):
    found = read(watched(plain, late))
    (told,) = found.told
    assert told.stage.id == "time-skew"
    assert told.stage["delay"] == pytest.approx(DELAY, rel=0.01)
    low, high = told.stage.parameters["delay"].ci95
    assert low - 0.5 * (high - low) < DELAY < high + 0.5 * (high - low)
    assert 0.0 < high - low < 0.05 * DELAY


def test_another_divider_is_a_note_and_no_cause(plain):
    found = read(watched(plain, divider=0.1, step_v=1e-4))
    assert found.told == ()
    assert any("0.1 times the drive" in n for n in found.notes)


def silent(drive):
    return 0.0 * drive


def another(drive):
    return 30.0 * np.sin(np.arange(drive.size) / 300.0)


@pytest.mark.parametrize("monitor", [
    silent, pytest.param(another, marks=pytest.mark.study),
])
def test_a_monitor_of_something_else_is_said_and_not_used(plain, monitor):
    found = read(watched(plain, monitor))
    assert found.told == ()
    assert found.bounds == {}
    assert any("drive monitor" in w and "not used" in w for w in found.warnings)


def test_without_a_monitor_there_is_nothing_to_read(plain):
    assert read(plain) is None


def test_a_sensor_that_is_late_behind_a_clean_monitor_is_a_skew_and_no_lag():
    sweeps = recordings(lambda x, drive, t: np.interp(t - DELAY, t, x), conditions=SPEEDS)
    found = diagnose(watched(sweeps))
    (finding,) = found.findings
    assert finding.cause == "time-skew"
    assert "amplifier-lag" not in finding.alternatives
    assert "drive monitor" in found.refused["amplifier-lag"]
    assert finding.parameters["delay"].value == pytest.approx(DELAY, rel=0.05)


def very_late(drive):
    return late(drive, 3e-4)


@pytest.mark.study
@pytest.mark.parametrize("fixed", [False, True])
def test_a_delay_that_the_displacement_denies_is_no_finding(plain, fixed):
    baseline = diagnose(plain).model if fixed else "classical"
    found = diagnose(watched(plain, late), baseline)
    assert found.findings == []
    assert len(found.rungs) == 1
    assert found.model.stage("time-skew") is None
    assert any("the displacement is not" in n for n in found.notes)
    assert found.rungs[0].rms_nm == pytest.approx(2.0, rel=0.1)  # the noise that was put in


@pytest.mark.study
def test_where_monitor_and_displacement_differ_the_displacement_counts():
    true = 1e-4
    sweeps = recordings(lambda x, drive, t: np.interp(t - true, t, x), conditions=SPEEDS)
    found = diagnose(watched(sweeps, very_late))
    (finding,) = found.findings
    assert finding.cause == "time-skew"
    low, high = finding.parameters["delay"].ci95
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    assert abs(true - middle) < 1.5 * half
    assert half < 0.1 * true
    # the rung is drawn with that delay, and comes down to the noise that was put in
    assert found.rungs[-1].rms_nm == pytest.approx(2.0, rel=0.1)
    assert finding.gain_percent > 10
    assert any("the displacement is what counts" in n for n in found.notes)


def test_a_lag_in_the_monitor_is_the_amplifiers_and_the_command_line_says_so(tmp_path, capsys):
    sweeps = watched(recordings(before=lagging, conditions=SPEEDS), lagging)
    files = []
    for s in sweeps:
        files.append(tmp_path / f"{s.condition} test {s.repeat}.csv")
        rows = np.column_stack([s.time_s, s.command_v, s.sensor_v, s.drive_monitor_v])
        np.savetxt(files[-1], rows, delimiter=",", comments="",
                   header="time_s,command_v,sensor_v,drive_monitor_v")  # fmt: skip
    out, model = tmp_path / "found.json", tmp_path / "model.json"
    assert main(["diagnose", *map(str, files), "--gain", "7.5", "--offset", "75", "--polarity",
                 "-1", "--sensitivity", "15.48um/V", "--history", "virgin", "--json", str(out),
                 "--save-model", str(model)]) == 0, capsys.readouterr().err  # fmt: skip
    (finding,) = json.loads(out.read_text())["findings"]
    assert (finding["cause"], finding["place"]) == ("amplifier-lag", "drive")
    assert finding["alternatives"] == []
    assert finding["gain_percent"] > 30
    low, high = finding["parameters"]["tau"]["ci95"]
    assert abs(TAU - 0.5 * (low + high)) < high - low
    assert any(s["id"] == "amplifier-lag" for s in json.loads(model.read_text())["stages"])


@pytest.mark.study
@pytest.mark.parametrize("tau", [7e-5, 4e-4])
def test_a_lag_behind_ramps_that_begin_between_samples_is_read_as_it_is(plain, tau):
    rng, fine = np.random.default_rng(8), 40
    at, volts = [0.0, 0.1], [0.0, 0.0]
    while at[-1] < 3.9:
        level = (volts[-1] + rng.uniform(20.0, 50.0)) % 70.0
        at += [at[-1] + abs(level - volts[-1]) / 3000.0, at[-1] + 0.1]
        volts += [level, level]
    time = np.arange(int(4.0 * RATE) * fine) / (RATE * fine)
    drive = np.interp(time, at, volts)
    behind, share = np.empty(time.size), -np.expm1(-1.0 / (RATE * fine * tau))
    behind[0] = drive[0]
    for k in range(1, time.size):
        middle = 0.5 * (drive[k] + drive[k - 1])
        behind[k] = behind[k - 1] + (middle - behind[k - 1]) * share
    drive, behind = drive[::fine], behind[::fine]
    sweep = plain[0].with_(
        command_v=(drive - 75.0) / 7.5, sensor_v=-0.1 * drive / 15.48, zero_v=0.0,
        drive_monitor_v=behind + 2e-3 * rng.standard_normal(drive.size),
    )
    found = read([sweep])
    assert found.between
    (told,) = found.told  # and no delay beside it
    assert told.stage.id == "amplifier-lag"
    assert told.stage["tau"] == pytest.approx(tau, rel=5e-3)


@pytest.mark.parametrize(("late_s", "said"), [
    (3.2e-4, "0.32 ms after the command"), (-1.653e-5, "0.01653 ms before the command"),
])  # fmt: skip
def test_a_monitor_comes_after_or_before_the_command(late_s, said):
    assert _comes(late_s).endswith(said)


@pytest.mark.parametrize(("ppm", "tau"), first_of(2, [
    (5000.0, 0.0), (-2000.0, TAU), (-8000.0, 0.0),
]))
def test_a_monitor_that_is_read_by_another_clock_shows_no_lag_of_its_own_and_no_delay(
    plain, ppm, tau
):
    """Several samples by the end, far more than a digitizer's delay."""
    def apart(drive, fine=50):
        t = np.arange(drive.size) / RATE
        dense = np.arange((drive.size - 1) * fine + 1) / (fine * RATE)
        volts = np.interp(dense, t, drive)
        if tau:
            keeps = np.exp(-1.0 / (fine * RATE * tau))
            volts = drive[0] + lfilter([1.0 - keeps], [1.0, -keeps], volts - drive[0])
        return np.interp(t / (1.0 + 1e-6 * ppm), dense, volts)

    found = read(watched(plain, amplifier=apart))
    assert [t.stage.id for t in found.told] == (["amplifier-lag"] if tau else [])
    if tau:
        low, high = found.told[0].stage.parameters["tau"].ci95
        assert low - 0.1 * TAU < TAU < high + 0.1 * TAU
    said = next(n for n in found.notes if "clocks of their own" in n)
    assert float(said.split(" by ")[1].split(" ppm")[0]) == pytest.approx(ppm, rel=0.03)


def test_a_limit_next_to_the_fastest_is_no_clipping_beside_clocks_that_hardly_differ():
    """Its peaks are lower by 20 mV; by the end a tenth of a sample is between the clocks.

    Where the highest drive is the fastest, an upper limit would lower none but those as well.
    """
    plain = recordings(conditions=tuple((f"0-{v:g}", 0.0, v, 4.0) for v in (30.0, 50.0, 75.0)))
    fastest, ppm = 2.0 * 75.0 * 4.0, 35.0
    limit = 0.9995 * fastest

    def amplifier(drive):
        t = np.arange(drive.size) / RATE
        return np.interp(t / (1.0 + 1e-6 * ppm), t, limited(drive, limit=limit))

    found = read(watched(plain, amplifier, noise=nothing, step_v=1e-4))
    assert [t.stage.id for t in found.told] == ["slew-limit"]
    assert fastest - found.told[0].stage["limit"] == pytest.approx(fastest - limit, rel=0.1)
    assert any("clocks of their own" in n for n in found.notes)
