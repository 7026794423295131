"""What is not named after all: it predicts far worse, nothing about it is sure, a monitor lacks it.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Elements, Maxwell, Model, Parameter
from piezo_rig.diagnosis import diagnose, late
from piezo_rig.diagnosis import taken_back as module
from piezo_rig.diagnosis.found import Finding
from piezo_rig.diagnosis.held_out import Errors
from piezo_rig.diagnosis.ladder import Ladder, Step
from piezo_rig.diagnosis.needed import too_long
from piezo_rig.diagnosis.scan import Scan
from piezo_rig.diagnosis.taken_back import taken_back, without_the_doubtful
from tests.diagnosis.small_bench import CONDITIONS, recordings


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


def finding(cause, gain_ci95, **intervals):
    numbers = {n: Parameter(0.5 * sum(ci), "1", ci95=ci) for n, ci in intervals.items()}
    numbers["whole"] = Parameter(0.0, "1")
    return Finding(cause, "actuator", 1e-3, 16.0, gain_ci95, numbers, [])


def test_a_last_rung_of_which_neither_size_nor_use_is_sure_is_not_named():
    last = finding("cycle-aging", [-4.0, 43.0], rate_per_decade=(-0.02, 0.05))
    found = without_the_doubtful(ladder("bend", "cycle-aging"), [last])
    assert [s.cause for s in found.steps] == ["bend"]
    assert "sure" in found.scans[-1].refused["cycle-aging"]


@pytest.mark.parametrize(("cause", "gain", "intervals"), [
    ("cycle-aging", [2.0, 43.0], {"rate_per_decade": (-0.02, 0.05)}),  # it helps
    ("cycle-aging", [-4.0, 43.0], {"rate_per_decade": (0.01, 0.05)}),  # there is some of it
    ("thermal-drift", [-4.0, 43.0], {"rate": (-9.0, -1.0), "settling": (-0.1, 0.2)}),
    ("direction-asymmetry", [-4.0, 43.0], {"ratio": (1.01, 1.2)}),
    ("initiation-stage", [-4.0, 43.0], {}),  # a table, whose size no interval says
    ("cycle-aging", None, {"rate_per_decade": (-0.02, 0.05)}),  # nothing was held out
])  # fmt: skip
def test_a_last_rung_of_which_something_is_sure_stays(cause, gain, intervals):
    last = finding(cause, gain, **intervals)
    assert without_the_doubtful(ladder("bend", cause), [last]) is None


def test_an_asymmetry_of_one_is_none():
    last = finding("direction-asymmetry", [-4.0, 43.0], ratio=(0.99, 1.02))
    assert without_the_doubtful(ladder("direction-asymmetry"), [last]).steps == ()


@pytest.mark.parametrize(("cause", "intervals"), [
    ("direction-asymmetry", {"ratio": (0.99, 1.01), "reach": (0.04, 1.7)}),
    ("thermal-drift", {"rate": (-9.0, 1.0), "settling": (0.1, 0.2)}),
    ("rate-dependence", {"lag_um": (-1e-3, 2e-3), "window_s": (1e-3, 2e-3)}),
])  # fmt: skip
def test_the_shape_of_something_says_nothing_of_how_much_there_is_of_it(cause, intervals):
    last = finding(cause, [-6.0, 7.0], **intervals)
    assert without_the_doubtful(ladder("bend", cause), [last]) is not None


def test_what_is_not_the_last_rung_stays():
    last = finding("cycle-aging", [-4.0, 43.0], rate_per_decade=(-0.02, 0.05))
    assert without_the_doubtful(ladder("cycle-aging", "bend"), [last]) is None


@pytest.mark.parametrize(("tau", "too"), [(1e-4, False), (5e-4, True)])
def test_a_lag_is_no_longer_than_what_a_drive_monitor_cannot_have_missed(tau, too):
    """Whatever the displacement makes of it: the monitor would have shown 0.1 ms."""
    lag = CAUSES["amplifier-lag"].of(None, tau=tau)
    table = Elements.from_curve(np.array([75.0]), np.array([0.12]))
    point = SimpleNamespace(model=Model((lag, Maxwell.of(table))))
    assert too_long(SimpleNamespace(longest={"amplifier-lag": 1e-4}), point, lag.id) == too
    assert not too_long(SimpleNamespace(longest={}), point, lag.id)


@pytest.mark.parametrize(("tau", "offered"), [(1e-4, True), (5e-4, False)])
def test_such_a_lag_is_not_put_in_a_delays_place(monkeypatch, tau, offered):
    lag = CAUSES["amplifier-lag"].of(None, tau=tau)
    model = Model((lag, Maxwell.of(Elements.from_curve(np.array([75.0]), np.array([0.12])))))
    there = SimpleNamespace(point=SimpleNamespace(model=model))
    monkeypatch.setattr(late, "candidates", lambda space, less: ([SimpleNamespace(id=lag.id)], {}))
    monkeypatch.setattr(late, "_instead", lambda search, own, other: there)
    search = SimpleNamespace(
        causes=["time-skew"], steps=[Step("time-skew", 1e-9, None)], fitted=there,
        space=SimpleNamespace(longest={lag.id: 1e-4}), tell=lambda text: None,
    )  # fmt: skip
    assert [id for _, id, _ in late._the_others(search)] == ([lag.id] if offered else [])


def test_an_answer_is_made_anew_without_what_was_taken_back(monkeypatch):
    """Any error counts as far too large: a zero that drifts is not named, and seen to be left."""
    monkeypatch.setattr(module, "FAR", 0.0)
    found = diagnose(recordings(sensor=lambda x, t, rng: x + 0.03 * t, conditions=CONDITIONS[:2]))
    assert found.findings == []
    assert "far worse" in found.refused["thermal-drift"]
    assert any("taken back" in note for note in found.notes)
    assert found.unexplained.detected
