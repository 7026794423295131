"""The thesis's tables, played: printed drive and displacement pairs, to their last digit.

Expected numbers: facts of the thesis as recomputed from Appendices A to C.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from piezo_rig.causes import load_model

FOLDER = Path(__file__).parents[2] / "calibration"


def displacement(name, *turns):
    """Displacement in um where a drive over these turning points ends, and at each of them."""
    model = load_model(FOLDER / f"thesis_{name}.json")
    parts = [np.linspace(a, b, 400, endpoint=False) for a, b in pairwise(turns)]
    drive = np.append(np.concatenate(parts), turns[-1])
    y = model.simulate(np.arange(drive.size) / 5000.0, drive)
    return y[::400]


@pytest.mark.parametrize(("drive", "um"), [(37.7, 4.814), (65.0, 9.195), (75.0, 10.880)])
def test_initiation(drive, um):
    assert displacement("range", 0.0, drive)[-1] == pytest.approx(um, abs=5e-4)


@pytest.mark.parametrize(("span", "um"), [(65.0, 8.247), (25.0, 2.709), (10.0, 1.027)])
def test_travel_of_later_half_loops(span, um):
    y = displacement("range", 0.0, span, 0.0, span)
    assert y[3] - y[2] == pytest.approx(um, abs=5e-4)
    assert y[1] - y[2] == pytest.approx(um, abs=5e-4)


def test_descending_from_65_v():
    assert displacement("range", 0.0, 65.0, 37.7)[-1] == pytest.approx(6.228, abs=5e-4)


def test_what_a_cycle_to_65_v_leaves():
    assert displacement("range", 0.0, 65.0, 0.0)[-1] == pytest.approx(0.948, abs=5e-4)


def test_a_nested_loop_of_the_range_model_need_not_close():
    y = displacement("range", 0.0, 65.0, 0.0, 65.0, 50.0, 65.0)
    assert y[3] - y[4] == pytest.approx(1.533, abs=5e-4)
    assert y[5] - y[4] == pytest.approx(1.556, abs=5e-4)


def test_classical_at_65_v():
    assert displacement("classical", 0.0, 65.0)[-1] == pytest.approx(9.747, abs=5e-4)


def test_the_printed_breakaway_forces_follow_from_the_springs():
    # f_i = k_i i dx; printed to four digits (Appendix C, elements 1, 20 and 40)
    table = load_model(FOLDER / "thesis_classical.json").maxwell.elements
    assert table.breakaway_v[[0, 19, 39]] == pytest.approx([0.3823, -3.7922, 68.5736], abs=6e-4)


def test_the_extremum_law_is_that_of_appendix_b():
    law = load_model(FOLDER / "thesis_extremum.json").stage("extremum-dependence")
    assert law["slope"] * 0.2947 == pytest.approx(2.807e-4, abs=5e-8)
    assert law["offset"] * 0.2947 == pytest.approx(-0.02512, abs=5e-6)
