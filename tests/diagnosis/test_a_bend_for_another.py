"""A small bend of the displacement looks like one of the drive, which is taken in first.

What the two differ by is no finding: the one takes the other's place.
"""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from tests.diagnosis.sliders import play, recorded

RATE, NOISE_UM = 5000.0, 3e-3
FIVE, THREE = (4.0, 0.5, 10.0, 1.0, 2.0), (10.0, 5.0, 20.0)


def triangles(hz):
    up = np.linspace(0.0, 62.0, round(RATE / hz / 2) + 1)
    return np.tile(np.concatenate([up[:-1], up[:0:-1]]), max(2, int(1.5 * hz)))


def session(seed, rates_hz):
    """Some rates, each twice, one after the other; before that a triangle that nobody recorded."""
    rng = np.random.default_rng(seed)
    up = np.linspace(0.0, 75.0, 800)
    drives = [triangles(hz) for hz in rates_hz for _ in range(2)]
    limits = np.sort(rng.uniform(0.5, 34.0, 24))
    x = play(np.concatenate([up, up[::-1], *drives]), limits, 0.01)[2 * up.size :]
    x = x - 0.0007 * x**2
    out, at = [], 0
    for k, drive in enumerate(drives):
        noise = rng.standard_normal(drive.size)
        for i in range(1, drive.size):
            noise[i] = 0.95 * noise[i - 1] + np.sqrt(1.0 - 0.95**2) * noise[i]
        seen = x[at : at + drive.size] - x[at] + NOISE_UM * noise
        at += drive.size
        which, again = divmod(k, 2)
        out.append(recorded(
            drive, seen, RATE, "unknown", k + 1, f"{rates_hz[which]} Hz", again + 1
        ))  # fmt: skip
    return out


def study(*which):
    return pytest.param(*which, marks=pytest.mark.study)


@pytest.mark.parametrize(("rates_hz", "seed"), [
    *(study(THREE, s) for s in (1, 2, 3)), *(study(FIVE, s) for s in (1, 2, 3)),
    *(study((4.0, 1.0, 10.0), s) for s in (1, 2, 3)), *(study((10.0, 2.0), s) for s in (1, 2)),
])  # fmt: skip
def test_a_bent_displacement_is_no_asymmetry(rates_hz, seed):
    found = diagnose(session(seed, rates_hz))
    assert found.findings == []
    assert not found.unexplained.detected
    assert found.rungs[-1].added in ("bend", "input-bend", "output-bend")
    assert found.rungs[-1].rms_nm < 1.1 * 1e3 * NOISE_UM
