"""Drives and displacements to both sides of zero: an end is where the data have theirs."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from small_bench import recordings

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Context
from piezo_rig.diagnosis import diagnose
from piezo_rig.studies.hidden import draw

BIPOLAR = (("30", -30.0, 30.0), ("60", -60.0, 60.0))


def above(drive):
    return np.minimum(drive, 57.0)


def both(drive):
    return np.clip(drive, -50.0, 55.0)


@pytest.mark.study
@pytest.mark.parametrize(("amplifier", "limits"), [
    (above, {"upper": 57.0}), (both, {"lower": -50.0, "upper": 55.0}),
])  # fmt: skip
def test_a_drive_that_is_clipped_is_told_with_every_limit(amplifier, limits):
    found = diagnose(recordings(conditions=BIPOLAR, before=amplifier))
    assert [f.cause for f in found.findings] == ["drive-clipping"]
    assert not found.unexplained.detected
    assert set(found.findings[0].parameters) == set(limits)
    for name, true in limits.items():
        assert found.findings[0].parameters[name].value == pytest.approx(true, abs=0.02)


@pytest.mark.parametrize(("low", "high", "amplifier"), [
    (-60.0, 60.0, both), (5.0, 75.0, lambda v: np.clip(v, 10.0, 66.0)),
])  # fmt: skip
@pytest.mark.study
def test_in_one_sweep_a_limit_at_one_end_is_not_the_difference_of_two(low, high, amplifier):
    # closed loops of one size cannot tell: the way there and back can
    found = diagnose(recordings(conditions=(("all", low, high),), before=amplifier))
    assert [f.cause for f in found.findings] == ["drive-clipping"]
    assert not found.unexplained.detected
    limits = found.findings[0].parameters
    ends = amplifier(np.array([-100.0, 100.0]))
    assert [limits["lower"].value, limits["upper"].value] == pytest.approx(ends, abs=0.02)


@pytest.mark.study
def test_a_sensor_that_ends_below_its_zero_is_told_with_its_level():
    def ends(x, t, rng):
        return np.maximum(x, x[0] - 5.0)

    found = diagnose(recordings(conditions=BIPOLAR, sensor=ends))
    assert [f.cause for f in found.findings] == ["sensor-clipping"]
    assert found.findings[0].parameters["level"].value == pytest.approx(-5.0, abs=2e-3)


@pytest.mark.parametrize(("id", "parameter", "context"), [
    ("drive-clipping", "upper", {"ends_v": (-100.0, -20.0)}),
    ("drive-clipping", "lower", {"ends_v": (-100.0, -20.0)}),
    ("sensor-clipping", "level", {"ends_um": (-6.0, 0.0)}),
])  # fmt: skip
def test_examples_lie_within_what_was_played_or_seen(id, parameter, context):
    data = Context(None, 6.0, 80.0, np.array([100.0]), 1e-3, 1.0, 1e3, **context)
    low, high = next(iter(context.values()))
    forms = [form[0][parameter] for form in CAUSES[id].variants(data)]
    inside = [x for x in forms if abs(x) < 1000.0]
    assert len(inside) > 5
    assert all(low < x < high for x in inside)


def test_what_is_clipped_at_one_end_may_be_so_at_the_other_and_more_at_this_one():
    data = Context(None, 6.0, 80.0, np.array([100.0]), 1e-3, 1.0, 1e3, ends_v=(-40.0, 40.0))
    stage = CAUSES["drive-clipping"].of(None, lower=-1000.0, upper=30.0)
    more = stage.also(data)
    cut = np.array([s["lower"] + 40.0 for s in more])
    besides = np.array([30.0 - s["upper"] for s in more])
    assert ((cut > 0.0) & (cut < 40.0)).all()
    assert set(np.round(besides / cut, 9)) == {0.0, 0.5, 1.0}
    assert not more[0].also(data)
    assert not stage.less()
    assert {(s["lower"], s["upper"]) for s in more[0].less()} == {
        (-1000.0, more[0]["upper"]), (more[0]["lower"], 1000.0),
    }  # fmt: skip


@pytest.mark.study
def test_a_limit_that_only_stood_in_for_another_cause_is_given_up_again():
    # the case that asked for it: 0.2 V cut off at the lower end while an asymmetry was missing
    case = draw("drive-clipping+direction-asymmetry", 2, "one", "white", 2000.0, 2)
    found = {f.cause: f for f in diagnose(case.sweeps).findings}
    limits = found["drive-clipping"].parameters
    assert set(limits) == {"upper"}
    true = case.truth.parameters["drive-clipping"]["upper"]
    assert limits["upper"].value == pytest.approx(true, abs=0.02)
