"""What is written on the instruments is not so: gain and sensitivity, on closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Cause
from piezo_rig.chain import Elements, Maxwell, Model

DRIVE = np.concatenate([np.linspace(0.0, 60.0, 121), np.linspace(60.0, 0.0, 121)[1:]])
TIME = np.arange(DRIVE.size) * 1e-3
MODEL = Model((Maxwell.of(Elements.from_curve(np.array([10.0, 100.0]), np.array([0.1, 0.15]))),))


def played(id, ratio):
    return MODEL.with_stage(CAUSES[id].of(None, ratio=ratio)).simulate(TIME, DRIVE)


def test_a_larger_gain_runs_further_along_the_curve():
    # 0.1 um/V up to 10 V, 0.15 um/V from there: 1 um + 0.15 (1.1 60 - 10)
    assert played("drive-gain", 1.1)[120] == pytest.approx(1.0 + 0.15 * 56.0)
    # the element gives way when the true drive has reached 10 V
    assert played("drive-gain", 1.25)[16] == pytest.approx(1.0)


def test_a_gain_error_is_the_drive_times_its_ratio():
    assert played("drive-gain", 0.97) == pytest.approx(MODEL.simulate(TIME, 0.97 * DRIVE))


def test_what_a_wrong_sensitivity_records_times_the_ratio_is_what_moved():
    assert 1.02 * played("sensor-scale", 1.02) == pytest.approx(MODEL.simulate(TIME, DRIVE))


def test_a_scale_moves_no_threshold_and_a_gain_moves_all():
    def knee(x):  # V at which the first rise becomes steeper
        return DRIVE[np.argmax(np.diff(x[:121], 2))]

    assert knee(played("sensor-scale", 1.25)) == pytest.approx(10.0, abs=0.6)
    assert knee(played("drive-gain", 1.25)) == pytest.approx(8.0, abs=0.6)


@pytest.mark.parametrize("id", ["drive-gain", "sensor-scale"])
def test_both_are_asked_for_only_of_a_fixed_model(id):
    kind = CAUSES[id]
    assert issubclass(kind, Cause)
    assert kind.needs_fixed_model
    assert np.array_equal(played(id, kind.neutral["ratio"]), MODEL.simulate(TIME, DRIVE))
