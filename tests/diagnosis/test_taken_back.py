"""A ladder that predicts far worse than it began is taken back to where it still predicts."""

import numpy as np
import pytest

from piezo_rig.diagnosis.held_out import Errors
from piezo_rig.diagnosis.ladder import Ladder, Step
from piezo_rig.diagnosis.scan import Scan
from piezo_rig.diagnosis.taken_back import taken_back


def errors(nm, stretches=1, worst=None):
    """As large in each of four stretches, but for the first if ``worst`` is given."""
    sizes = np.full(4, float(nm))
    if worst is not None:
        sizes[0] = worst
    square = 100 * (1e-3 * sizes) ** 2
    return Errors(square, np.full(4, 100.0), np.arange(4), 1.0, square.copy(), stretches)


def ladder(*causes):
    none = np.zeros(0)
    scan = Scan((), none, none, none, none, {"creep": "too small"})
    return Ladder(None, tuple(Step(cause, 1e-9, None) for cause in causes), (scan,))


def test_what_follows_a_rung_that_still_predicts_is_taken_back_and_said():
    whole = ladder("input-bend", "output-bend", "bend", "rate-dependence")
    found, said = taken_back(whole, [errors(nm) for nm in (4.5, 11.0, 6.0, 111.0, 70.0)])
    assert [s.cause for s in found.steps] == ["input-bend", "output-bend"]
    assert "70 nm against 4.5 nm" in said
    assert "bend, rate-dependence" in said
    refused = found.scans[-1].refused
    assert refused["creep"] == "too small"
    assert "70 nm" in refused["rate-dependence"]
    assert "bend" not in refused


def test_all_of_a_ladder_of_which_no_rung_predicts_is_taken_back():
    found, _ = taken_back(ladder("creep", "slew-limit"), [errors(nm) for nm in (4.0, 9.0, 12.0)])
    assert found.steps == ()


@pytest.mark.parametrize("ends", [1.0, 4.0, 7.9])
def test_a_ladder_that_ends_near_where_it_began_or_below_is_left_alone(ends):
    assert taken_back(ladder("creep", "bend"), [errors(4.0), errors(50.0), errors(ends)]) is None


def test_where_nothing_was_added_nothing_is_taken_back():
    assert taken_back(ladder(), [errors(4.0)]) is None


def test_one_stretch_that_goes_where_no_other_has_been_takes_nothing_back():
    begun, after = errors(4.0, 4), errors(3.0, 4, worst=100.0)
    assert after.rms_nm > 2.0 * begun.rms_nm
    assert taken_back(ladder("creep"), [begun, after]) is None
