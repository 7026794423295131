"""`piezo-rig export` of a model: what a user gets, and its tables."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from piezo_rig.causes import STAGES, load_model
from piezo_rig.chain import Maxwell, Model, Parameter, save_model
from piezo_rig.chain.elements import Elements
from piezo_rig.cli import main
from piezo_rig.model_export import identifier
from piezo_rig.model_export.tables import operator_table
from piezo_rig.resources import find

# Two elements: 4 V/um up to 1 um, then 1 V/um up to 3 um. Worked out by hand.
TABLE = Elements(np.array([3.0, 1.0]), np.array([1.0, 3.0]))


@pytest.fixture
def model(tmp_path):
    creep = STAGES["creep"]({"rate_per_decade": Parameter(0.01, "1", (0.008, 0.012))})
    drift = STAGES["thermal-drift"].of(rate=2.0)
    return save_model(Model((Maxwell.of(TABLE), creep, drift), name="mine"), tmp_path / "m.json")


def export(*words):
    return main(["export", *map(str, words)])


def test_the_c_file_has_the_name_that_was_asked_for(model, tmp_path, capsys):
    out = tmp_path / "my stack.c"
    assert export("--format", "c", model, "--out", out, "--sample-rate", 1000) == 0
    said, text = capsys.readouterr().out, out.read_text()
    assert "left out: thermal-drift: it follows the clock" in said
    assert "double my_stack_step(struct my_stack *s, double drive_v)" in text
    assert "Sample period: 0.001 s" in text


def test_the_c_file_is_the_same_every_time(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        assert export("--format", "c", "thesis_range", "--out", tmp_path / name / "m.c") == 0
    assert (tmp_path / "a/m.c").read_bytes() == (tmp_path / "b/m.c").read_bytes()


def test_the_csv_has_every_number_with_its_unit(model, tmp_path):
    assert export("--format", "csv", model, "--out", tmp_path / "m.csv") == 0
    with (tmp_path / "m.csv").open() as handle:
        rows = list(csv.DictReader(handle))

    def column(table, quantity):
        return [float(r["value"]) for r in rows
                if r["table"] == table and r["quantity"] == quantity]

    assert column("elements", "k_v_per_um") == [3.0, 1.0]
    assert column("elements", "breakaway_v") == [3.0, 3.0]
    assert column("first_rise", "drive_v") == [0.0, 4.0, 6.0]
    assert column("later_branch", "drive_v") == [0.0, 8.0, 12.0]
    assert column("later_branch", "displacement_um") == [0.0, 2.0, 6.0]
    assert column("operators", "threshold_v") == [0.0, 4.0]
    assert column("operators", "weight_um_per_v") == [0.25, 0.75]
    (rate,) = [r for r in rows if r["quantity"] == "rate_per_decade"]
    assert (rate["value"], rate["unit"], rate["ci95_low"], rate["ci95_high"]) == (
        "0.01", "1", "0.008", "0.012")


def test_the_mat_has_the_same(model, tmp_path):
    from scipy.io import loadmat

    assert export("--format", "mat", model, "--out", tmp_path / "m.mat") == 0
    found = loadmat(tmp_path / "m.mat", squeeze_me=True, struct_as_record=False)["model"]
    maxwell, creep, _ = found.stages
    assert list(maxwell.operators.weight_um_per_v) == [0.25, 0.75]
    assert list(creep.parameters.rate_per_decade.ci95) == [0.008, 0.012]
    assert creep.parameters.rate_per_decade.unit == "1"


def test_play_operators_of_the_table_are_the_model():
    model = load_model(find("models", "thesis_classical"))
    threshold, weight = (c.values for c in operator_table(model.maxwell.elements))
    drive = np.array([0.0, 70.0, 20.0, 50.0, 30.0, 75.0, 5.0])
    state, expected = np.zeros(threshold.size), []
    for v in drive:
        state = np.clip(state, v - threshold, v + threshold)
        expected.append(float(weight @ state))
    assert model.simulate(np.arange(7.0), drive) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("stem", "name"), [
    ("range-model 2", "range_model_2"), ("2 stacks", "piezo_2_stacks"), ("double", "piezo_double"),
    ("_x", "x"), ("ü", "model"),
])  # fmt: skip
def test_any_file_name_makes_a_c_name(stem, name):
    assert identifier(stem) == name


def test_a_sample_rate_without_c_is_a_slip(model, tmp_path, capsys):
    assert export("--format", "csv", model, "--out", tmp_path / "m", "--sample-rate", 10) == 2
    assert "--sample-rate goes with --format c" in capsys.readouterr().err


def test_a_model_is_not_written_over_itself(model, capsys):
    assert export("--format", "csv", model, "--out", model) == 2
    assert capsys.readouterr().err.startswith("error[overwrites-input]:")
