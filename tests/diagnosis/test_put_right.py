"""A given model that one number brings home: a gain or a sensitivity, told by least squares."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from piezo_rig.diagnosis.engine import plain_space
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.held import own_um_of
from piezo_rig.diagnosis.held_out import held_out_errors
from piezo_rig.diagnosis.put_right import put_right
from piezo_rig.diagnosis.refit import refit
from piezo_rig.diagnosis.unexplained import _known_nm
from piezo_rig.identification import identify, prepare
from tests.diagnosis.small_bench import recordings, relaxation

NOISE_NM = 2.0


@pytest.fixture(scope="module")
def model():
    return identify(recordings(seed=3), "classical").model


def asked(model, **changed):
    sweeps = recordings(seed=3, **changed)
    space = plain_space(group_tracks(prepare(sweeps, first_rises=True), sweeps), model)
    space.own_um, space.loose = own_um_of(model, space.groups), True
    first = refit(space, Point(model, fixed=tuple(s.id for s in model.stages)))

    def error_nm(fitted):
        return held_out_errors(space, fitted, "sweep").rms_nm

    return put_right(space, first, error_nm(first), NOISE_NM, error_nm), space, error_nm


@pytest.mark.parametrize(("cause", "changed"), [
    ("sensor-scale", {"sensor": lambda x, t, rng: x / 1.02}),
    ("drive-gain", {"before": lambda drive: 1.02 * drive}),
])  # fmt: skip
def test_the_number_that_brings_it_home_is_told_with_where_it_may_lie(model, cause, changed):
    step, space, error_nm = asked(model, **changed)
    assert step.cause == cause
    ratio = step.fitted.point.model.stage(cause).parameters["ratio"]
    assert ratio.ci95[0] < 1.02 < ratio.ci95[1]
    assert ratio.ci95[1] - ratio.ci95[0] < 4e-3
    assert error_nm(step.fitted) < 1.3 * NOISE_NM
    assert step.p_value < 1e-3
    assert cause in step.fitted.point.fixed  # it belongs to what is given now
    assert not space.loose


@pytest.mark.parametrize("changed", [
    {},  # nothing
    {"effect": lambda x, drive, t: x + 0.05 * relaxation(x, 0.05)},  # it creeps now
])  # fmt: skip
def test_what_no_number_brings_home_is_left_to_others(model, changed):
    step, space, _ = asked(model, **changed)
    assert step is None
    assert space.loose


@pytest.mark.parametrize(("left_nm", "known_nm"), [
    (2.19, 1.74),  # no further off than it was: how much of that was noise it does not say
    (5.0, 0.0),
])  # fmt: skip
def test_what_a_given_model_was_off_by_at_home_is_no_news(left_nm, known_nm):
    space = SimpleNamespace(own_um=1.74e-3)
    assert _known_nm(space, NOISE_NM, left_nm) == pytest.approx(known_nm)
