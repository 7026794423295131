"""`diagnose --follow-up`: what it plays, on what, and what it says of the outcome.

The diagnosis itself is replaced: what it finds is not the point here, and takes its time.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from piezo_rig import diagnosis
from piezo_rig.cli import main
from piezo_rig.diagnosis.follow_up import FollowUp, decide
from piezo_rig.diagnosis.found import Diagnosis, Finding, Rung
from piezo_rig.diagnosis.unexplained import Unexplained
from piezo_rig.run_file.reader import Run

sys.path.insert(0, str(Path(__file__).parents[1] / "run_file"))
from short_run import played

NEXT = """
schema = "piezo-rig/protocol/1"
name = "next"
sample_rate = 5000
[[condition]]
waveform = "triangle"
lower_v = 0
upper_v = 40
frequency_hz = 10
cycles = 1
"""


def finding(cause, alternatives=()):
    return Finding(cause, "actuator", 1e-6, 10.0, [9.0, 11.0], {}, list(alternatives))


def said(sweeps, findings, follow_up=None):
    return Diagnosis(
        len(sweeps), sum(s.samples for s in sweeps), 3, "condition", [], "classical",
        [Rung("classical", 10.0, 1.0)], 2.0, findings,
        Unexplained(False, 1.0, 0.0, 1.0, [], ""), follow_up, None, [],
    )  # fmt: skip


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    folder = tmp_path_factory.mktemp("short")
    return played(folder)


@pytest.fixture
def run(short, tmp_path, monkeypatch):
    """A run of its own in a folder of its own, beside its rig and a protocol to play next; the
    first diagnosis confounds two causes, that of everything knows."""
    for name in ("r.h5", "rig.toml"):
        (tmp_path / name).write_bytes((short.parent / name).read_bytes())
    protocol = tmp_path / "protocols" / "next.toml"
    protocol.parent.mkdir()
    protocol.write_text(NEXT)

    def diagnose(sweeps, baseline, seed, tell):
        if len(sweeps) > 6:
            return said(sweeps, [finding("rate-dependence")])
        advice = FollowUp(str(protocol), ["range-dependence", "rate-dependence"], 0.1)
        return said(sweeps, [finding("range-dependence", ["rate-dependence"])], advice)

    monkeypatch.setattr(diagnosis, "diagnose", diagnose)
    return tmp_path / "r.h5"


def follow(run, rig, *more):
    return main(["diagnose", str(run), "--follow-up", "--rig", str(rig), *more])


def test_it_plays_the_advice_joins_the_runs_and_decides(run, capsys):
    out = run.with_name("d.json")
    assert follow(run, run.with_name("rig.toml"), "--json", str(out)) == 0
    (new,) = run.parent.glob("next_*.h5")
    printed = capsys.readouterr().out
    assert f"follow-up {new}" in printed
    assert "decided: rate-dependence" in printed
    assert "no longer possible: range-dependence" in printed
    found = json.loads(out.read_text())
    assert found["data"]["sweeps"] == 7
    assert found["followed_up"]["run"] == str(new)
    assert found["followed_up"]["decided"] is True
    assert found["followed_up"]["fell"] == ["range-dependence"]


def test_the_new_run_has_the_datas_rate_and_its_clock_goes_on_where_they_end(run):
    assert follow(run, run.with_name("rig.toml")) == 0
    (new,) = run.parent.glob("next_*.h5")
    before, (after,) = Run(run).sweeps(), Run(new).sweeps()
    assert after.sample_rate == before[0].sample_rate == 2000.0
    assert after.origin == "SIMULATED"
    assert after.history == "virgin"
    assert after.start_time > max(s.start_time + s.samples / s.sample_rate for s in before)


def test_with_nothing_confounded_it_plays_nothing(run, monkeypatch, capsys):
    monkeypatch.setattr(diagnosis, "diagnose", lambda sweeps, *_: said(sweeps, [finding("creep")]))
    assert follow(run, run.with_name("rig.toml")) == 0
    assert "nothing is confounded: nothing is played" in capsys.readouterr().out
    assert not list(run.parent.glob("next_*"))


def refused(run, capsys, code):
    assert not list(run.parent.glob("next_*.h5"))
    err = capsys.readouterr().err
    assert err.startswith(f"error[{code}]")
    return err


def test_another_stack_is_refused_before_anything_is_played(run, capsys):
    rig = run.with_name("other.toml")
    rig.write_text(run.with_name("rig.toml").read_text() + "\nseed = 9\n")
    assert follow(run, rig) == 2
    assert "another stack" in refused(run, capsys, "follow-up-bench")


def test_imported_data_are_not_followed_up_on_a_bench(run, capsys):
    csv = run.with_name("first.csv")
    csv.write_text("time_s,drive_v,displacement_um\n" + "".join(
        f"{k / 1000},{abs(k % 100 - 50)},{0.1 * abs(k % 100 - 50)}\n" for k in range(50, 400)
    ))  # fmt: skip
    assert follow(csv, run.with_name("rig.toml")) == 2
    err = refused(run, capsys, "follow-up-bench")
    assert "the data are IMPORTED, the bench is SIMULATED" in err
    assert "not touched" in err


def test_limits_hold_as_they_do_for_run(run, capsys):
    rig = run.with_name("tight.toml")
    text = run.with_name("rig.toml").read_text()
    rig.write_text(text.replace("slew_v_per_s = 10000.0", "slew_v_per_s = 301.0"))
    assert follow(run, rig) == 3
    refused(run, capsys, "limit-slew")


@pytest.mark.parametrize("words", [["--follow-up"], ["--rig", "simulated_bench"]])
def test_follow_up_and_rig_come_together(run, words, capsys):
    assert main(["diagnose", str(run), *words]) == 2
    assert "--rig" in refused(run, capsys, "usage")


SET = ["range-dependence", "rate-dependence", "creep"]


@pytest.mark.parametrize(("joined", "kept", "fell", "still", "text"), [
    ({"creep": []}, ["creep"], SET[:2], [], "decided: creep"),
    ({"creep": ["thermal-drift"]}, ["creep"], SET[:2], ["thermal-drift"],
     "undecided: creep still cannot be told from thermal-drift"),
    ({"creep": ["rate-dependence"]}, ["creep"], SET[:1], ["rate-dependence"],
     "undecided: creep still cannot be told from rate-dependence"),
    ({"creep": [], "rate-dependence": []}, ["creep", "rate-dependence"], SET[:1], [],
     "decided: creep and rate-dependence are there, side by side"),
    ({"mains-hum": []}, [], SET, [], "undecided: in all data together none of them is found"),
    ({"time-skew": ["creep"]}, [], SET[:2], ["creep"],
     "undecided: creep is possible, but another cause is found first"),
])  # fmt: skip
def test_what_survives_is_said(joined, kept, fell, still, text):
    decision = decide(SET, joined)
    assert (decision.kept, decision.fell, decision.still) == (kept, fell, still)
    assert decision.text == text
    assert decision.decided == text.startswith("decided")


def test_a_protocol_that_goes_beyond_the_data_is_not_played(run, monkeypatch, capsys):
    advice = FollowUp("rate_sweep", ["range-dependence", "rate-dependence"], 0.1,
                      "scaled to the 0 to 3.75 V of these recordings")  # fmt: skip
    monkeypatch.setattr(diagnosis, "diagnose", lambda sweeps, *_: said(
        sweeps, [finding("range-dependence", ["rate-dependence"])], advice
    ))  # fmt: skip
    assert follow(run, run.with_name("rig.toml")) == 3
    err = refused(run, capsys, "follow-up-range")
    assert "scaled to the 0 to 3.75 V" in err
    assert "not touched; nothing was played" in err
    assert not list(run.parent.glob("rate_sweep_*"))
