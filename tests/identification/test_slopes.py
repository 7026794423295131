"""The thesis's slope scheme on clean data of a thesis-like actuator: parameters to 1 %."""

from __future__ import annotations

import numpy as np
import pytest
from recordings import DX, FIRST, FIRST_TOP, TOP, K, classical, lawful, matrix, sweep
from small_models import LAWS

from piezo_rig.identification import identify


def test_the_step_is_the_travel_of_the_first_rise_over_the_elements():
    found = identify(matrix(classical), "classical", "slopes", 7)
    assert found.slopes.dx_um == pytest.approx(DX, rel=1e-6)
    table = found.model.maxwell.elements
    # slopes to 1 %; springs are their differences
    assert table.slopes == pytest.approx(np.cumsum(K[::-1])[::-1], rel=0.01)


@pytest.mark.parametrize("name", ["range", "extremum"])
def test_first_springs_are_paired_with_their_own_half_loops(name):
    law, stages = LAWS[name]
    spans = (7.0, 9.0, 11.0, FIRST_TOP)
    found = identify(matrix(lambda t: lawful(t, law, 400), spans, 4, FIRST_TOP), name, "slopes", 7)
    for id, values in stages.items():
        assert found.slopes.r_squared[id] > 0.98
        assert found.model.stage(id)["slope"] == pytest.approx(values["slope"], rel=0.01)
        assert found.model.stage(id)["offset"] == pytest.approx(values["offset"], abs=0.02)
    assert found.model.stage("initiation-stage").elements.slopes == pytest.approx(
        np.cumsum(FIRST[::-1])[::-1], rel=0.01
    )


def test_first_and_last_cycle_are_left_out():
    found = identify(matrix(classical, (10.0,), 5), "classical", "slopes", 7)
    # of 10 half loops of 0-10 V the first and last two stay out; the top side likewise
    assert "left out" in found.left_out[-1]
    assert len(found.slopes.first_springs.k1) < 20


def test_a_law_that_makes_the_fit_worse_is_said():
    drive, y = classical([0.0, *([TOP, 0.0] * 12)])
    # rising half loops begin a little softer for another reason than a law
    y = y - 0.1 * np.sin(np.pi * drive / TOP) * (np.gradient(drive) > 0)
    one = sweep(drive, y, history="unknown")
    found = identify([one], "direction", "slopes", elements=7)
    plain = identify([one], "initiation", "slopes", elements=7)
    assert found.fitted.rms_nm > plain.fitted.rms_nm
    assert any("the fit is worse" in note for note in found.left_out)
    assert not any("the fit is worse" in note for note in plain.left_out)


def test_a_law_that_is_there_needs_no_warning():
    law, _ = LAWS["range"]
    sweeps = matrix(lambda turns: lawful(turns, law), spans=(6.0, 8.0, FIRST_TOP), top=FIRST_TOP)
    found = identify(sweeps, "range", "slopes", elements=7)
    assert not any("the fit is worse" in note for note in found.left_out)
