"""What stages keep of a drive or a displacement is what they would make anew."""

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.causes.creep import TIMES_S, weights
from piezo_rig.chain import Signal
from piezo_rig.chain.bend import Bend

TIME = np.arange(400) / 1000.0
DRIVE = 30.0 * np.sin(2.0 * np.pi * 5.0 * TIME)
STAGES = [
    CAUSES["rate-dependence"].of(None, lag_um=0.01, exponent=0.7),
    CAUSES["rate-dependence"].of(None, lag_um=0.02, exponent=0.7),
    CAUSES["rate-dependence"].of(None, lag_um=0.02, exponent=0.9, window_s=0.02),
    CAUSES["cycle-aging"].of(None, rate_per_decade=0.01, whole=1.0),
    CAUSES["cycle-aging"].of(None, rate_per_decade=0.02),
    Bend.of(None, from_v=0.0, over_v=30.0, square=0.1, cube=0.02, fourth=-0.03, fifth=0.01),
    CAUSES["creep"].of(None, rate_per_decade=0.02),
    CAUSES["creep"].of(None, rate_per_decade=0.03, share_1s=2.0),
]


def test_stages_that_share_a_signal_do_what_they_do_alone():
    shared = Signal(TIME, DRIVE, 0.1 * DRIVE)
    for _ in range(2):
        for stage in STAGES:
            alone = stage.act(Signal(TIME, DRIVE, 0.1 * DRIVE)).displacement_um
            assert np.array_equal(stage.act(shared).displacement_um, alone)


def test_another_drive_is_not_taken_for_the_one_before():
    first = Signal(TIME, DRIVE, 0.1 * DRIVE)
    stage = STAGES[0]
    stage.act(first)
    other = first.with_drive(2.0 * DRIVE)
    alone = stage.act(Signal(TIME, 2.0 * DRIVE, 0.1 * DRIVE)).displacement_um
    assert np.array_equal(stage.act(other).displacement_um, alone)


def test_a_bend_is_its_polynomial():
    u = DRIVE / 30.0
    bent = Bend.act(STAGES[5], Signal(TIME, DRIVE, np.zeros(TIME.size))).displacement_um
    assert bent == pytest.approx(0.1 * u**2 + 0.02 * u**3 - 0.03 * u**4 + 0.01 * u**5)


def test_creep_of_a_step_with_times_that_are_rounded():
    time = 1000.0 + np.arange(300) / 1000.0  # steps differ by their rounding
    step = np.where(np.arange(300) > 0, 1.0, 0.0)
    crept = CAUSES["creep"].of(None, rate_per_decade=0.05).act(Signal(time, 10.0 * step, step))
    # exact for a ramp over the first step: 1 - tau/h (1 - exp(-h/tau)), then relaxing on
    h = 1e-3
    held = np.arange(299)[:, None] * h
    lag = 1.0 - TIMES_S / h * -np.expm1(-h / TIMES_S)
    each = 1.0 - (1.0 - lag) * np.exp(-held / TIMES_S)
    expected = step[1:] + 0.05 * each @ weights()
    assert crept.displacement_um[1:] == pytest.approx(expected, rel=1e-8)
