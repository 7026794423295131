"""Long sessions: a third of the drives is looked at first, and all of them have the last word."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose, first_look
from piezo_rig.diagnosis.climb import climb
from piezo_rig.diagnosis.first_look import look
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.held_out import held_out_errors
from piezo_rig.diagnosis.refit import refit
from piezo_rig.identification import prepare
from tests.diagnosis.small_bench import RATE, recordings, relaxation
from tests.diagnosis.spaces import begun

RISING = tuple((f"0-{v}", 0.0, float(v)) for v in range(20, 80, 5))
FALLING = tuple((f"75-{v}", float(v), 75.0) for v in range(10, 60, 10))
MATRIX = RISING + FALLING


@pytest.fixture(scope="module")
def matrix():
    sweeps = recordings(conditions=MATRIX)
    return group_tracks(prepare(sweeps, first_rises=True), sweeps)


@pytest.fixture
def at_any_length(monkeypatch):
    monkeypatch.setattr(first_look, "MUCH", 0)


def test_a_third_of_them_goes_as_far_as_all(matrix, at_any_length):
    some = first_look.some_of(matrix)
    names = [g.condition for g in some.groups]
    assert len(names) == 6
    assert names == [g.condition for g in matrix.groups if g.condition in names]  # in their order
    assert "0-75" in names
    assert "75-10" in names  # the largest of those that do not go back to 0
    assert some.travel_um == pytest.approx(matrix.travel_um, rel=0.01)


def test_few_drives_and_short_ones_are_looked_at_at_once(matrix, monkeypatch):
    assert first_look.some_of(matrix) is None  # these are short
    monkeypatch.setattr(first_look, "MUCH", 0)
    assert first_look.some_of(matrix.with_(matrix.groups[:14])) is None


def creeping(share):
    def creep(x, drive, t):
        return x + share * sum(relaxation(x - x[0], tau) for tau in (0.01, 0.03, 0.1, 0.3, 1.0))

    return creep


@pytest.mark.study
def test_what_some_drives_show_is_found_with_all_of_them(monkeypatch):
    monkeypatch.setattr(first_look, "MUCH", 0)
    monkeypatch.setattr(first_look, "MANY", 8)

    def late(x, drive, t):
        return np.interp(t - 0.7 / RATE, t, x)

    said: list[str] = []
    few = recordings(late, conditions=MATRIX[::2])
    found = diagnose(few, tell=said.append)
    assert "4 drives of 9" in said
    assert {f.cause for f in found.findings} == {"time-skew"}
    delay = found.findings[0].parameters["delay"]
    assert delay.value == pytest.approx(0.7 / RATE, rel=0.02)
    assert found.rungs[-1].rms_nm == pytest.approx(found.noise_floor_nm, rel=0.05)
    assert not found.unexplained.detected


@pytest.mark.study
def test_what_is_in_any_doubt_is_left_to_all_drives():
    space, plain = begun(recordings(creeping(8e-5)))
    first, rng = refit(space, plain), np.random.default_rng(0)
    gates = [(lambda f: held_out_errors(space, f, "sweep").rms_nm, 1.03)]
    silent = [lambda text: None, gates, 2.0, 0, lambda less, fitted: True, False]
    found = climb(space, first, rng, *silent)
    assert [s.cause for s in found.steps] == ["creep"]
    assert found.steps[0].p_value > 1e-9
    assert look(space, first, np.random.default_rng(0), *silent).steps == ()
