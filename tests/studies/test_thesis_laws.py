"""The laws of Appendix B stand in docs/thesis.md with the digits that the thesis prints."""

from pathlib import Path

import pytest

from piezo_rig.causes import load_model
from piezo_rig.resources import find
from piezo_rig.studies.thesis_tables import laws


@pytest.mark.parametrize(
    "row",
    [
        "| k1, range (slope, offset) | 7.465e-3, -0.3578 |",
        "| f1, range (slope, offset) | 2.200e-3, -0.1054 |",
        "| k1, extremum (slope, offset) | 9.526e-4, -0.08523 |",
        "| f1, extremum (slope, offset) | 2.807e-4, -0.02512 |",
    ],
)
def test_a_printed_law_is_given_as_printed(row):
    models = {n: load_model(find("models", f"thesis_{n}")) for n in ("range", "extremum")}
    assert row in laws(0.2947, models, 0.2947)
    assert row in (Path(__file__).parents[2] / "docs" / "thesis.md").read_text(encoding="utf-8")
