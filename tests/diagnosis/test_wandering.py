"""An ageing goes with the logarithm of the count of cycles; a gain that changes otherwise does not.

Recordings of one sweep, of springs and sliders that the program does not know.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.wandering import wandering
from piezo_rig.run_file.sweep import Sweep
from tests.diagnosis.sliders import play

RATE, HZ, CYCLES = 1000.0, 2.0, 24
LIMITS = np.linspace(0.5, 30.0, 40)


def recording(gain):
    """One sweep of triangles; ``gain(t)`` of the displacement."""
    rng = np.random.default_rng(3)
    time = np.arange(int(CYCLES / HZ * RATE)) / RATE
    drive = 60.0 * (1.0 - np.abs(2.0 * ((HZ * time) % 1.0) - 1.0))
    moved = gain(time) * play(drive, LIMITS, 0.002) + 2e-3 * rng.standard_normal(time.size)
    return Sweep("sweep_0001", drive, moved, RATE, 1.0, 0.0, 1.0, 1, 0.0, "0-60", 1, "virgin", 0.0,
                 "SIMULATED")  # fmt: skip


@pytest.mark.study
@pytest.mark.parametrize(("gain", "ageing"), [
    (lambda t: 1.0 - 0.01 * np.log10(1.0 + HZ * t), True),
    (lambda t: 1.0 + 0.005 * np.tanh((t - 7.3) / 0.4), False),
    (lambda t: 1.0 + 0.01 * np.sin(2.0 * np.pi * t / 5.0), False),
])  # fmt: skip
def test_an_ageing_is_one_and_a_step_or_a_swing_is_none(gain, ageing):
    found = diagnose([recording(gain)])
    names = [f.cause for f in found.findings]
    assert names == (["cycle-aging"] if ageing else [])
    if ageing:
        rate = found.findings[0].parameters["rate_per_decade"]
        assert rate.ci95[0] < -0.01 < rate.ci95[1]


@pytest.mark.parametrize("rest", [0, 600])
def test_what_a_gain_does_is_no_more_than_what_is_left(rest):
    """Of a part that hardly moves the gain is of noise, and no part of what wanders."""
    rng = np.random.default_rng(7)
    time = np.arange(20 * 600) / RATE
    moved = 4.0 * np.sin(2.0 * np.pi * 2.0 * time)
    if rest:
        moved[-rest:] = 1e-4 * np.sin(0.1 * np.arange(rest))
    gain = 1.0 + 1e-3 * np.sin(2.0 * np.pi * time / time[-1])
    left = (gain - 1.0) * moved + 2e-3 * rng.standard_normal(time.size)
    if rest:
        left[-rest:] += 3.0 * moved[-rest:]  # a gain of 300 % of next to nothing
    group = SimpleNamespace(
        predicted=lambda model: moved, measured_um=(moved + left)[None], blocks=[(0, time.size)],
    )
    space = SimpleNamespace(groups=SimpleNamespace(groups=[group]))
    share, rms_nm = wandering(space, SimpleNamespace(point=SimpleNamespace(model=None)))
    assert share == pytest.approx(1e-3 / np.sqrt(2.0), rel=0.1)
    assert rms_nm == pytest.approx(1e3 * 4.0 / np.sqrt(2.0) * 1e-3 / np.sqrt(2.0), rel=0.1)
    assert rms_nm < 1e3 * np.std(left)
