"""Something unexplained is claimed only above what is allowed for it (design, section 4.3)."""

from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezo_rig.diagnosis.found import Rung
from piezo_rig.diagnosis.rungs import by_laws_nm
from piezo_rig.diagnosis.unexplained import (
    Unexplained,
    with_bursts,
    with_gain,
    with_levels,
    with_line,
    with_wandering,
)
from piezo_rig.diagnosis.unsteady import Unsteady

SIZES = st.floats(1e-3, 50.0)


def verdict(detected, rms_nm, allowance_nm):
    """``rms_nm`` : beyond what is allowed, where something is detected"""
    if detected:
        return Unexplained(True, 1e-9, allowance_nm + rms_nm, allowance_nm, ["drive"], "bent")
    return Unexplained(False, 0.4, min(rms_nm, allowance_nm), allowance_nm, [], "")


RESTS = st.builds(verdict, st.booleans(), SIZES, SIZES)


@given(RESTS, SIZES, SIZES, SIZES, st.sampled_from(["gain", "line", "bursts", "levels", "walk"]))
def test_nothing_is_detected_below_what_is_allowed(rest, rms_nm, floor_nm, of_ageing_nm, kind):
    seen = SimpleNamespace(p_value=1e-9, rms_nm=rms_nm, share=1e-3, frequency=62.0, text="seen")
    found = {
        "gain": lambda: with_gain(rest, Unsteady(1e-9, 1e-3, rms_nm), floor_nm, of_ageing_nm),
        "line": lambda: with_line(rest, seen, floor_nm),
        "bursts": lambda: with_bursts(rest, seen, floor_nm),
        "levels": lambda: with_levels(rest, seen),
        "walk": lambda: with_wandering(rest, 1e-3, rms_nm),
    }[kind]()
    assert not found.detected or found.rms_nm > found.allowance_nm
    assert found.detected >= rest.detected
    assert found.text.startswith(rest.text)


@pytest.mark.parametrize(("of_ageing_nm", "detected"), [(0.1, True), (0.5, False)])
def test_a_gain_that_ageing_leaves_unsteady_is_no_news(of_ageing_nm, detected):
    """A law of another form leaves repeats that differ by some of what it took."""
    rest = verdict(False, 0.1, 0.36)
    gain = Unsteady(1e-6, 1.8e-4, 0.296)  # less than the base's mismatch, which has no part in it
    found = with_gain(rest, gain, 1.5, of_ageing_nm)
    assert found.detected == detected
    if detected:
        assert (found.rms_nm, found.depends_on) == (0.296, ["displacement", "clock"])


def test_what_one_law_may_leave_is_counted_by_itself():
    rungs = [Rung("classical", 13.0, 1.0), Rung("creep", 5.0, 1.0), Rung("cycle-aging", 3.0, 1.0)]
    assert by_laws_nm(rungs, "cycle-aging") == pytest.approx(0.05 * 4.0)
    # of a creep twice as much: its law is one of several
    assert by_laws_nm(rungs) == pytest.approx(((0.1 * 12.0) ** 2 + (0.05 * 4.0) ** 2) ** 0.5)
