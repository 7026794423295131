"""Answers to the challenge: how they are read, and what they are worth."""

from __future__ import annotations

import json

import pytest

from piezo_rig.challenge.answers import oracle_gains, read_answer, row_of
from piezo_rig.challenge.score import figures, first_is_fair, score_text
from piezo_rig.errors import InputError

TRUTH = {
    "case": "case_0001", "cause": "creep", "causes": ["creep"], "parameters": {},
    "d_prime": [40.0], "asked": 40.0, "reached": True, "form": "straight", "protocol": "matrix",
    "noise": "white", "left_nm": {"": 10.0, "creep": 4.0},
    "oracle": {"findings": [{"cause": "creep", "p": 0.0, "alternatives": ["thermal-drift"]}],
               "unexplained": False},
}  # fmt: skip
NULL = TRUTH | {"cause": "none", "causes": [], "left_nm": {"": 3.0},
                "oracle": {"findings": [], "unexplained": False}}  # fmt: skip


def answer(cause, alternatives=()):
    found = [{"cause": cause, "p": 1e-9, "gain": 50.0, "gain_ci95": [40.0, 61.0],
              "parameters": {}, "alternatives": list(alternatives)}] if cause else []
    return {"findings": found, "unexplained": {"detected": False}}  # fmt: skip


def test_a_first_finding_is_right_if_it_is_hidden_or_if_nobody_could_tell_it_apart():
    assert first_is_fair(row_of(TRUTH, answer("creep")))
    assert first_is_fair(row_of(TRUTH, answer("thermal-drift", ["creep"])))
    assert not first_is_fair(row_of(TRUTH, answer("thermal-drift")))
    assert not first_is_fair(row_of(TRUTH, answer("resonance", ["creep"])))
    assert not first_is_fair(row_of(TRUTH, answer(None)))


def test_more_than_two_false_alarms_in_a_hundred_fail_and_so_do_fewer_than_nine_firsts_in_ten():
    good = [row_of(TRUTH, answer("creep"))] * 9 + [row_of(TRUTH, answer(None))]
    quiet, alarm = row_of(NULL, answer(None)), row_of(NULL, answer("creep"))
    assert figures([*good, *[quiet] * 98, alarm, alarm]).passed
    assert not figures([*good, *[quiet] * 97, alarm, alarm, alarm]).passed
    assert not figures([*good[1:], *[quiet] * 10]).passed


def test_a_case_that_broke_is_a_miss_or_a_false_alarm():
    got = figures([row_of(TRUTH, None, "broke"), row_of(NULL, None, "broke")])
    assert (got.failures, got.false_alarms, got.first_fair, got.known) == (2, 1, 0, 1)
    assert not got.passed


def test_gains_are_the_oracles_in_the_order_of_the_answer():
    both = TRUTH | {"causes": ["creep", "mains-hum"],
                    "left_nm": {"": 10.0, "creep": 8.0, "mains-hum": 5.0, "creep+mains-hum": 2.0}}
    hum, creep = answer("mains-hum")["findings"], answer("thermal-drift", ["creep"])["findings"]
    assert oracle_gains(both, [*hum, *creep]) == pytest.approx([50.0, 60.0])
    assert oracle_gains(both, answer("resonance")["findings"]) == [None]


def finding(**said):
    return json.dumps({"findings": [{"cause": "creep"} | said]})


@pytest.mark.parametrize(("text", "said"), [
    ("", "{path}: empty"),
    ('{"findings": [}', "{path}: line 1, column 15: not JSON"),
    ("[]", '{path}: it is []; expected an object, {{"name": value}}'),
    ("{}", "{path}: findings is missing; expected a list of findings"),
    ('{"findings": {}}', "{path}: findings is {{}}; expected a list of findings"),
    ('{"findings": ["creep"]}',
     '{path}: findings[0] is "creep"; expected an object, {{"name": value}}'),
    ('{"findings": [{}]}',
     '{path}: findings[0].cause is missing; expected the id of a cause, such as "creep"'),
    (finding(cause=7),
     '{path}: findings[0].cause is 7; expected the id of a cause, such as "creep"'),
    (finding(alternatives="cycle-aging"),
     '{path}: findings[0].alternatives is "cycle-aging"; expected a list of ids'),
    (finding(alternatives=[None]),
     '{path}: findings[0].alternatives[0] is missing; expected the id of a cause, such as "creep"'),
    (finding(gain_percent="42"),
     '{path}: findings[0].gain_percent is "42"; expected a finite number'),
    (finding(gain_ci95=[40]), "{path}: findings[0].gain_ci95 is [40]; expected two numbers, "
     "[low, high]"),
    (finding(gain_ci95=[44, 40]), "{path}: findings[0].gain_ci95 is [44, 40]; expected two "
     "numbers, [low, high]"),
    (finding(parameters={"rate": {"value": float("inf")}}),
     "{path}: findings[0].parameters.rate.value is Infinity; expected a finite number"),
    (finding(parameters={"rate": {"value": 10**400}}),
     "{path}: findings[0].parameters.rate.value is 1" + 59 * "0"
     + " ...; expected a finite number"),
    (finding(parameters={"rate": {"ci95": [1, 2]}}),
     "{path}: findings[0].parameters.rate.value is missing; expected the number that ci95 is of"),
    ('{"findings": [], "unexplained": {"detected": "no"}}',
     '{path}: unexplained.detected is "no"; expected true or false'),
])  # fmt: skip
def test_an_answer_of_another_shape_is_refused_by_field_and_expectation(text, said, tmp_path):
    path = tmp_path / "case_0001.json"
    path.write_text(text)
    with pytest.raises(InputError) as refused:
        read_answer(path)
    assert refused.value.code == "challenge-answer"
    assert refused.value.what == said.format(path=path)


@pytest.mark.parametrize("text", ["[" * 100_000, '{"findings": ' + "9" * 10_000 + "}"])
def test_an_answer_of_no_sensible_size_is_refused(text, tmp_path):
    (tmp_path / "case_0001.json").write_text(text)
    with pytest.raises(InputError, match="not JSON of a sensible size"):
        read_answer(tmp_path / "case_0001.json")


def test_what_an_answer_leaves_out_or_gives_as_null_is_not_scored(tmp_path):
    path = tmp_path / "case_0001.json"
    path.write_text(finding(alternatives=None, gain_percent=None, gain_ci95=None, parameters={
        "step": {"value": [79.1, None], "ci95": None}, "rate": {"value": 2, "ci95": [1, 3]},
    }))  # fmt: skip
    (said,) = read_answer(path)["findings"]
    assert (said["alternatives"], said["gain"], said["gain_ci95"]) == ([], None, None)
    assert said["parameters"] == {"rate": {"value": 2.0, "ci95": [1.0, 3.0]}}
    assert read_answer(path)["unexplained"] == {"detected": False}


def test_a_name_that_is_no_cause_counts_as_wrong_and_is_said():
    rows = [row_of(TRUTH, answer("Creep", ["creep", "gremlins"])), row_of(NULL, answer("creep"))]
    got, text = figures(rows), score_text(rows)
    assert (got.first, got.first_fair, got.false_alarms) == (0, 0, 1)
    said = [line for line in text.splitlines() if "no id of docs/causes.md" in line]
    assert [line.split("'")[1] for line in said] == ["Creep", "gremlins"]
    assert "no id" not in score_text(rows[1:])
