"""Ramps that are all equally fast show a lag, if the drive stands still between them."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.run_file.sweep import Sweep
from tests.diagnosis.sliders import play

RATE, TAU = 5000.0, 6e-4
LIMITS = np.linspace(0.5, 30.0, 40)
LEVELS = (0.0, 70.0, 5.0, 60.0, 12.0, 66.0, 3.0, 48.0, 20.0, 72.0, 0.0)  # V


@pytest.mark.study
def test_a_lag_behind_equally_fast_ramps_is_named_alone():
    at, volts = [0.0, 0.2], [0.0, 0.0]
    for level in LEVELS[1:]:
        # as long as the way is far, so that all half loops have one mean speed
        seconds = 0.004 * abs(level - volts[-1])
        at += [at[-1] + 0.1 * seconds, at[-1] + seconds]
        volts += [level, level]
    fine = 10
    time = np.arange(int(at[-1] * RATE) * fine) / (RATE * fine)
    drive = np.interp(time, at, volts)
    behind, share = np.empty(time.size), -np.expm1(-1.0 / (RATE * fine * TAU))
    behind[0] = 0.0
    for k in range(1, time.size):
        middle = 0.5 * (drive[k] + drive[k - 1])
        behind[k] = behind[k - 1] + (middle - behind[k - 1]) * share
    rng = np.random.default_rng(4)
    moved = play(behind, LIMITS, 0.002)[::fine]
    moved = moved + 2e-3 * rng.standard_normal(moved.size)
    found = diagnose([Sweep(
        "sweep_0001", drive[::fine], moved, RATE, 1.0, 0.0, 1.0, 1, 0.0, "holds", 1, "virgin", 0.0,
        "SIMULATED",
    )])  # fmt: skip
    assert [f.cause for f in found.findings] == ["amplifier-lag"]
    tau = found.findings[0].parameters["tau"]
    assert tau.value == pytest.approx(TAU, rel=0.02)
    assert tau.ci95[0] < TAU < tau.ci95[1]
