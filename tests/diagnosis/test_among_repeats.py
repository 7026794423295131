"""What recordings of one drive differ by speaks for what can make them differ, and for that alone.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from piezo_rig.diagnosis import spare
from piezo_rig.diagnosis.among_repeats import PLAINLY, as_able, told
from piezo_rig.diagnosis.refit import refit
from tests.diagnosis.small_bench import recordings
from tests.diagnosis.spaces import begun, with_member

SETTLES_S, BY_UM = 80.0, 0.2


def warming(x, t, rng):
    """A zero that moves towards where it will be, from when the session began."""
    return x - BY_UM * np.exp(-(t - 10.0) / SETTLES_S)


def drifting(**values):
    """Recordings of a zero that moves or does not, beside a model in which it does as given."""
    space, plain = begun(recordings(sensor=warming), noisy=recordings())
    return space, with_member(plain, "thermal-drift", {"rate": 0.01}, **values)


@pytest.fixture(scope="module")
def settling():
    space, point = drifting(rate=1e3 * BY_UM / SETTLES_S, settling=1.0 / SETTLES_S)
    return space, refit(space, point, held=True)


def test_a_zero_that_settles_is_told_by_the_difference_of_an_early_and_a_late_recording(settling):
    space, fitted = settling
    model = fitted.point.model
    # closed form: slopes of two recordings, half of their difference in each of them
    expected = 0.0
    for group in space.groups.groups:
        begins = np.array(group.starts_s)[:, None] - min(
            min(g.starts_s) for g in space.groups.groups
        )
        moved = -1e3 * BY_UM * np.exp(-(begins + group.time_s) / SETTLES_S)
        apart = moved - moved.mean(axis=0)
        apart -= apart.mean(axis=1, keepdims=True)
        expected += 0.5 * float(np.sum(apart**2)) / 2.0**2  # noise of 2 nm
    found = told(space, model, model.without("thermal-drift"))
    assert expected > 2.0 * PLAINLY
    # the measured spectrum is raised by its standard errors, most where it is known least
    assert 0.4 * expected < found < expected + 4.0 * np.sqrt(2.0 * expected)


def test_a_steady_drift_is_the_same_in_all_of_them_and_says_nothing():
    space, point = drifting(rate=0.2)
    model = point.model
    assert told(space, model, model.without("thermal-drift")) == pytest.approx(0.0, abs=1e-6)
    assert as_able(space, model, "thermal-drift", ["creep"]) == ["creep"]


def test_what_cannot_make_them_differ_is_no_alternative(settling):
    space, fitted = settling
    others = ["creep", "cycle-aging", "extremum-dependence"]
    kept = as_able(space, fitted.point.model, "thermal-drift", others)
    assert "creep" not in kept
    assert "extremum-dependence" not in kept


def test_a_drift_that_is_not_there_is_told_against():
    space, plain = begun(recordings())
    point = with_member(plain, "thermal-drift", {"rate": 0.01}, rate=1e3 * BY_UM / SETTLES_S,
                        settling=1.0 / SETTLES_S)  # fmt: skip
    assert told(space, point.model, plain.model) < -PLAINLY


class Faint:
    """A search whose only member is not certain enough by itself."""

    def __init__(self, space, fitted):
        self.space, self.fitted, self.barred = space, fitted, {}
        self.steps = [SimpleNamespace(cause="thermal-drift")]

    @property
    def causes(self):
        return [s.cause for s in self.steps]

    def tell(self, text):
        pass


@pytest.mark.parametrize(("differ", "kept"), [(True, True), (False, False)])
def test_a_member_is_not_faint_where_recordings_differ_by_what_it_does(
    monkeypatch, settling, differ, kept
):
    """With everything else allowed for it may be hardly anything: that is of the means."""
    space, fitted = settling
    less = fitted.point.without("thermal-drift")
    steady = with_member(less, "thermal-drift", {"rate": 0.01}, rate=0.1)
    search = Faint(space, fitted if differ else SimpleNamespace(point=steady))
    monkeypatch.setattr(spare, "settle", lambda *_: None)
    monkeypatch.setattr(spare, "certainties", lambda *_: {"thermal-drift": 0.9 * spare.BESIDE})
    monkeypatch.setattr(spare, "_certain", lambda *_: spare.BESIDE)
    monkeypatch.setattr(spare, "plain_bend", lambda *_: False)
    monkeypatch.setattr(spare, "_explains_the_rest", lambda *_: False)
    monkeypatch.setattr(spare, "refit", lambda *_, **__: SimpleNamespace(point=less))
    spare.faint(search)
    assert (search.causes == ["thermal-drift"]) == kept
