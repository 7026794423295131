"""Tables that people write by hand: comment lines pass in all of them alike."""

from __future__ import annotations

import re

import numpy as np
import pytest

from piezo_rig.chain import Elements, Maxwell, Model, save_model
from piezo_rig.cli import main

TABLES = {
    "calibrate": ("command_v,drive_v", ["-10,0.01", "-8,15", "-6,29.99", "-4,45", "0,75.01"]),
    "compensate": ("time_s,displacement_um", ["0,0", "0.1,1", "0.2,1", "0.3,0.9"]),
    "plan": ("time_s,drive_v", ["0,0", "0.1,20", "0.2,20", "0.3,0"]),
    "simulate": ("time_s,drive_v", ["0,0", "0.1,20", "0.2,20", "0.3,0"]),
}
"""Verb -> header and rows of the table that it reads."""

PROTOCOL = """schema = "piezo-rig/protocol/1"
[[condition]]
name = "followed"
waveform = "file"
path = "table.csv"
"""


@pytest.fixture
def read(tmp_path, capsys):
    """A function: verb and lines of its table -> exit status, and what stderr got."""
    spring = Model((Maxwell.of(Elements(np.array([10.0]), np.array([1.0]))),))
    model, table = str(save_model(spring, tmp_path / "model.json")), tmp_path / "table.csv"
    protocol, out = tmp_path / "p.toml", str(tmp_path / "out")
    protocol.write_text(PROTOCOL)
    words = {
        "calibrate": ["calibrate", str(table), "--out", out],
        "compensate": ["compensate", model, str(table), "--out", out],
        "plan": ["plan", str(protocol)],
        "simulate": ["simulate", model, str(table), "--out", out],
    }

    def reading(verb: str, lines: list[str]) -> tuple[int, str]:
        table.write_text("\n".join(lines) + "\n")
        return main(words[verb]), capsys.readouterr().err

    return reading


@pytest.mark.parametrize("verb", TABLES)
def test_comments_pass_wherever_they_stand(read, verb):
    header, rows = TABLES[verb]
    lines = ["# table.csv", "", header, "# 1,2", rows[0], "  # begins with blanks", *rows[1:], "#"]
    assert read(verb, lines) == (0, "")


@pytest.mark.parametrize("verb", TABLES)
def test_a_comment_after_numbers_is_no_number(read, verb):
    header, rows = TABLES[verb]
    status, error = read(verb, ["# table.csv", header, rows[0] + " # noon", *rows[1:]])
    assert status == 2
    assert re.search(r"table\.csv:( line )?3\b", error)


@pytest.mark.parametrize("verb", TABLES)
def test_comments_alone_are_no_table(read, verb):
    status, error = read(verb, ["# table.csv", "# " + TABLES[verb][0]])
    assert status == 2
    assert "table.csv" in error
