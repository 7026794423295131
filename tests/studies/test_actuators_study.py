"""The study of many actuators knows what it planted, and judges by what was said of it."""

from __future__ import annotations

import re

from piezo_rig.bench import plant_config
from piezo_rig.config import load_rig
from piezo_rig.studies.actuators import PLANTED, TEMPLATE, actuator, judged, kinds


def test_every_planted_actuator_is_there_and_its_settings_are_known_to_the_plant():
    listed = kinds(40)
    assert [k for k in listed if k] == list(PLANTED)
    rig = load_rig()
    benches = [actuator(i, kind, rig) for i, kind in enumerate(listed)]
    assert len({b.actuator.serial for b in benches}) == len(benches)
    assert len({b.plant["stack"]["edge"] for b in benches}) == len(benches)
    for bench in benches:
        plant_config(bench)  # an unknown setting is an error
    assert benches[listed.index("mains hum of 60 nm")].plant["mains_hum"]["on"]


def test_a_planted_one_counts_by_what_was_said_of_it_and_others_as_false():
    rows = [{"file": f"{i}", "status": "done", "origin": "SIMULATED", "um_per_v": 1.0 + 0.001 * i,
             "error_code": None} for i in range(40)]  # fmt: skip
    first, second, *_ = (i for i, k in enumerate(kinds(40)) if k)
    rows[first]["um_per_v"] = 2.0
    rows[second] |= {"status": "failed", "error_code": "run-file", "um_per_v": None}
    rows[39]["um_per_v"] = 3.0
    said, false = judged(rows, [{"file": f"{first}", "findings": ["creep"]}])
    assert false == 1
    assert re.search(r"\| um_per_v \(z \d+\) \| creep \|", said)
    assert "| run-file | - |" in said


def test_the_template_describes_the_columns_that_a_table_has():
    text = TEMPLATE.read_text(encoding="utf-8")
    for column in ("um_per_v", "loop_percent", "first_rise_um_per_v", "error_code", "status"):
        assert f"`{column}`" in text
