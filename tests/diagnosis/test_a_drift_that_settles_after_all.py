"""A drift that was taken for a steady one beside something else, and dies away over the session."""

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Context
from piezo_rig.chain import Elements, Maxwell, Model
from piezo_rig.diagnosis.climb import Search
from piezo_rig.diagnosis.ladder import Step
from piezo_rig.diagnosis.refit import refit
from tests.diagnosis.small_bench import recordings
from tests.diagnosis.spaces import begun, with_member

DRIFT = "thermal-drift"
BEGINS_S, SETTLES_S = 10.0, 60.0


def drifting(rate_um_s, settles_s):
    def sensor(x, t, rng):
        since = t - BEGINS_S
        if settles_s is None:
            return x + rate_um_s * since
        return x + rate_um_s * settles_s * -np.expm1(-since / settles_s)

    return recordings(sensor=sensor)


def with_a_steady_one(sweeps):
    """A climb that has found a steady drift, and looks for the next thing."""
    space, plain = begun(sweeps, noisy=recordings())  # what settles is no noise
    first = refit(space, plain)
    drift = refit(space, with_member(first.point, DRIFT, {"rate": 1.0}, rate=5.0))
    return Search(
        space, first, np.random.default_rng(0), lambda text: None, [(lambda f: 2.0, 1.1)], 2.0, 0,
        lambda less, fitted, unseen=True: unseen, [Step(DRIFT, 0.0, drift)],
    )  # fmt: skip


@pytest.mark.study
def test_that_it_settles_is_found_without_anything_else_that_asks_for_it():
    search = with_a_steady_one(drifting(30e-3, SETTLES_S))
    search.forward()
    assert search.causes == [DRIFT]
    settles = search.fitted.point.model.stage(DRIFT)
    assert settles["settling"] == pytest.approx(1.0 / SETTLES_S, rel=0.15)
    assert settles["rate"] == pytest.approx(30.0, rel=0.1)


def test_a_steady_one_stays_one():
    search = with_a_steady_one(drifting(10e-3, None))
    search.forward()
    assert search.causes == [DRIFT]
    assert "settling" not in search.fitted.point.model.stage(DRIFT).parameters


def session(session_s):
    table = Elements.from_curve(np.array([75.0]), np.array([0.12]))
    model, slews = Model((Maxwell.of(table),)), np.array([300.0])
    return Context(model, 12.0, 75.0, slews, 1e-3, 2.0, 1000.0, session_s=session_s)


def test_its_slope_in_the_middle_of_the_session_is_the_steady_ones():
    forms = CAUSES[DRIFT].of(None, rate=7.0).also(session(100.0))
    assert len(forms) == 3
    for form in forms:
        assert form["rate"] * np.exp(-form["settling"] * 50.0) == pytest.approx(7.0)


@pytest.mark.parametrize(("session_s", "values"), [
    (3.0, {"rate": 7.0}),  # one recording and a half
    (100.0, {"rate": 0.0}),
    (100.0, {"rate": 7.0, "settling": 0.01}),
])  # fmt: skip
def test_one_recording_and_what_settles_already_ask_for_no_more(session_s, values):
    assert CAUSES[DRIFT].of(None, **values).also(session(session_s)) == []
