"""The independent bench: what cycles and the recording before leave behind, on closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.studies.hidden import draw
from piezo_rig.studies.hidden.body import Body
from piezo_rig.studies.hidden.history import CycleAging, Remanence, half_cycles
from piezo_rig.studies.hidden.locked import locked

UP = np.linspace(0.0, 60.0, 61)
THREE = np.concatenate([[0.0], np.tile(np.concatenate([UP[1:], UP[-2::-1]]), 3)])
TIME = np.arange(THREE.size) * 1e-2
LINEAR = Body(0.1, np.array([1e3]), np.array([0.0]), (0.0, 0.0), "without hysteresis")


def test_half_cycles_are_counted_and_holds_belong_to_the_one_before():
    number, share = half_cycles(np.array([0.0, 1.0, 2.0, 2.0, 1.0, 0.0, 3.0]))
    assert list(number) == [0, 0, 0, 1, 1, 2]
    assert share == pytest.approx([0.5, 1.0, 1.0, 0.5, 1.0, 1.0])


def test_the_stroke_of_cycle_n_grows_with_its_logarithm():
    x = locked(LINEAR, (CycleAging(size=0.1, sign=-1.0, form="A"),), TIME, THREE)
    assert x[60::120] == pytest.approx(6.0 * (1.0 - 0.1 * np.log10([1, 2, 3])))
    assert x[::120] == pytest.approx(np.zeros(4), abs=1e-12)


def test_where_there_is_no_hysteresis_form_b_has_nothing_to_age():
    x = locked(LINEAR, (CycleAging(size=0.1, form="B"),), TIME, THREE)
    assert x == pytest.approx(0.1 * THREE)


@pytest.mark.parametrize("form", ["A", "B"])
def test_ageing_has_the_d_prime_that_was_asked_for(form):
    case = draw("cycle-aging", 2, "rates", "1/f", d_prime=25.0, form=form)
    assert case.truth.reached
    assert case.truth.d_prime[0] == pytest.approx(25.0, rel=0.02)


def test_a_recording_begins_with_a_share_of_the_memory_of_the_one_before():
    body = Body(0.1, np.array([20.0]), np.array([0.05]), (0.0, 0.0), "one operator")
    rise = np.linspace(0.0, 60.0, 61)
    drives = [np.append(rise, rise[-2::-1])] * 3
    for form, late in (("A", 20.0), ("B", None)):
        e = Remanence(size=0.25, form=form).placed(body, drives)
        assert not np.any(e.on_recording(0))
        change = e.on_recording(1)
        if late is not None:  # it slides from 20 + 0.25 x 20 V on
            assert change[25] == pytest.approx(-0.05 * 5.0)
        # once it slides the memory is gone: a constant is left
        assert change[61:] == pytest.approx(np.full(60, -0.05 * 0.25 * 20.0))
