"""The verdict says what matters first, and says so where nothing does or all of it is worse."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from small_diagnoses import diagnosis

from piezo_rig.diagnosis.document import text
from piezo_rig.diagnosis.follow_up import FollowUp
from piezo_rig.diagnosis.found import Finding, Rung
from piezo_rig.report.page import page
from piezo_rig.report.sections import next_html
from piezo_rig.report.verdict import verdict


def with_gains(*gains):
    """A quiet diagnosis with these findings: cause, gain and its interval; 10 nm and down."""
    found, rungs, at = diagnosis("quiet"), [Rung("classical", 10.0, 1.0)], 10.0
    findings = []
    for k, (cause, gain, ci95) in enumerate(gains):
        at *= 1.0 - gain / 100.0
        rungs.append(Rung(cause, at, 0.5, k))
        findings.append(Finding(cause, "actuator", 1e-9, gain, ci95, {}, []))
    return replace(found, findings=findings, rungs=rungs)


def test_causes_stand_by_their_weight_and_those_of_none_apart():
    said = verdict(with_gains(("time-skew", 0.5, [0.4, 0.6]), ("creep", 40.0, [38.0, 42.0]),
                              ("range-dependence", 80.0, [79.0, 81.0])))  # fmt: skip
    assert [line.split(",")[0] for line in said.causes] == ["range-dependence", "creep"]
    assert "with hardly any of the error: time-skew" in said.rest[0]
    assert said.head.startswith("2 causes were named")


@pytest.mark.parametrize(("gain", "ci95", "words"), [
    (6.0, [-6.0, 16.0], "whether it helps to predict is not sure"),
    (-18.0, [-26.0, -5.0], "predicted worse with it"),
    (40.0, [38.0, 42.0], "40 % less"),
])  # fmt: skip
def test_a_gain_is_said_with_as_much_doubt_as_it_has(gain, ci95, words):
    (line,) = verdict(with_gains(("creep", gain, ci95))).causes
    assert words in line


def test_a_model_that_predicts_worse_than_the_baseline_is_not_recommended():
    said = verdict(with_gains(("creep", -50.0, [-60.0, -40.0])))
    assert said.open
    assert any("Do not use the extended model" in line for line in said.rest)
    assert not any("Nothing that remains" in line for line in said.rest)


def test_what_is_worse_is_no_remedy():
    drift = with_gains(("thermal-drift", 40.0, [38.0, 42.0]))
    assert any(line.startswith("To do") for line in verdict(drift).rest)
    worse = with_gains(("thermal-drift", -50.0, [-60.0, -40.0]))
    assert not any(line.startswith("To do") for line in verdict(worse).rest)


def test_a_given_model_that_stays_further_off_than_at_home_leaves_the_verdict_open():
    found = replace(with_gains(("creep", 40.0, [38.0, 42.0])), at_home_nm=2.5)
    said = verdict(found)
    assert said.open
    assert any("was by 2.5" in line and "has changed" in line for line in said.rest)
    assert not any("stands out of the noise" in line for line in said.rest)


def test_no_cause_is_credited_with_what_the_base_model_took():
    found = diagnosis("quiet")
    rungs = [Rung("classical", 29.0, 1.0), Rung("bend", 4.5, 0.5), Rung("creep", 3.5, 0.5, 0)]
    creep = Finding("creep", "actuator", 1e-9, 22.0, [20.0, 24.0], {}, [])
    said = " ".join(verdict(replace(found, findings=[creep], rungs=rungs)).lines)
    assert "Most of that went with bend" in said


def test_it_is_the_last_that_a_terminal_shows():
    found = with_gains(("creep", 40.0, [38.0, 42.0]))
    lines = verdict(found).in_a_terminal()
    assert lines[0].startswith("verdict   One cause was named")
    assert all(len(line) <= 100 for line in lines)
    assert all(line.isascii() for line in lines)
    assert "gain = 40.0 %  [38.0, 42.0]: 10 to 6 nm rms" in "\n".join(text(found))


def test_reasons_that_are_the_same_are_given_once():
    found = replace(diagnosis("quiet"), refused={"a": "why", "b": "why", "c": "other"})
    assert [x for x in text(found) if x.startswith("left out")] == [
        "left out  a, b: why", "left out  c: other",
    ]  # fmt: skip


def test_a_protocol_that_goes_beyond_the_data_is_not_to_be_typed_as_it_is_shipped():
    creep = Finding("creep", "actuator", 1e-9, 40.0, [38.0, 42.0], {}, ["thermal-drift"])
    beyond = FollowUp("rate_sweep", ["creep", "thermal-drift"], 0.1, "scaled to 0 to 3.75 V")
    found = replace(with_gains(("creep", 40.0, [38.0, 42.0])), findings=[creep], follow_up=beyond)
    said = next_html(found, ["run.h5"])
    assert "Do not play it as it is shipped" in said
    assert "piezo-rig run ./my_rate_sweep.toml" in said
    assert "piezo-rig run rate_sweep" not in said
    assert "--follow-up" not in said


def test_what_is_unexplained_gets_something_to_try():
    rest = replace(diagnosis("quiet").unexplained, detected=True, text="5 nm rms are left",
                   depends_on=["frequency"])  # fmt: skip
    said = next_html(replace(diagnosis("quiet"), unexplained=rest), [])
    assert "rate_sweep" in said
    assert "scaled to what this stack was driven with" in said
    assert "no protocol is needed to tell the named causes apart" in said


def test_a_figure_shows_all_but_a_cause_and_then_everything():
    found = diagnosis("many")
    seen = page("run", found, [], {})
    for finding in found.findings:
        if finding.cause != "mains-hum":
            assert f"everything but {finding.cause}" in seen
    assert "with everything" in seen
