"""Delays and lags of milliseconds under triangles of one frequency: no loop that opens by itself.

A short delay opens every loop in proportion to its speed, and so does an actuator that lags. Only
beside corners is there a difference, and there a delay of 2 ms is nothing like ten of 0.2 ms.
"""

from __future__ import annotations

import numpy as np
import pytest
from small_bench import RATE, recordings

from piezo_rig.diagnosis import diagnose

SEVERAL_RANGES = tuple((f"0-{high}", 0.0, float(high)) for high in (20, 40, 60, 75))


def lagging(tau):
    """The drive behind a first-order amplifier, exactly for a drive that is linear in between."""

    def lag(drive):
        kept = np.exp(-1.0 / RATE / tau)
        out = np.empty(drive.size)
        out[0] = drive[0]
        for i in range(1, drive.size):
            slope = (drive[i] - drive[i - 1]) * RATE
            behind = out[i - 1] - drive[i - 1] + tau * slope
            out[i] = drive[i] - tau * slope + behind * kept
        return out

    return lag


@pytest.mark.study
@pytest.mark.parametrize(
    "delay", [pytest.param(0.001, marks=pytest.mark.study), 0.002]
)
def test_a_delay_of_milliseconds_is_a_delay_and_nothing_else(delay):
    sweeps = recordings(lambda x, drive, t: np.interp(t - delay, t, x), conditions=SEVERAL_RANGES)
    found = diagnose(sweeps)
    assert [f.cause for f in found.findings] == ["time-skew"]
    assert found.findings[0].parameters["delay"].value == pytest.approx(delay, rel=0.03)
    assert not found.unexplained.detected


@pytest.mark.study
def test_a_lag_of_milliseconds_is_a_lag_and_nothing_else():
    found = diagnose(recordings(before=lagging(0.002), conditions=SEVERAL_RANGES))
    assert [f.cause for f in found.findings] == ["amplifier-lag"]
    assert found.findings[0].parameters["tau"].value == pytest.approx(0.002, rel=0.03)
    assert not found.unexplained.detected
