"""Many samples lost in the only recording of a drive: a base that is fitted to what comes before
and to what comes after shows a share of them, and all of them are asked for.
"""

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from tests.diagnosis.sliders import play, recorded

RATE, NOISE_UM = 5000.0, 2.5e-3


def ramps(seed: int, samples: int) -> np.ndarray:
    """Between random ends, each at a random speed of 150 to 300 V/s."""
    rng = np.random.default_rng(seed)
    parts, here = [np.zeros(1)], 0.0
    while sum(p.size for p in parts) < samples:
        there = rng.uniform(45.0, 75.0) if len(parts) % 2 else rng.uniform(0.0, 25.0)
        n = round(RATE * abs(there - here) / rng.uniform(150.0, 300.0))
        parts.append(np.linspace(here, there, n + 1)[1:])
        here = there
    return np.concatenate(parts)[:samples]


@pytest.mark.parametrize(("seed", "lost"), [
    (1, 23), pytest.param(2, 31, marks=pytest.mark.study),
])  # fmt: skip
def test_all_of_many_samples_that_were_lost_are_counted(seed, lost):
    samples, at = 36_000, 15_203
    drive = ramps(seed, samples + lost)
    moved = play(drive, np.linspace(0.5, 36.0, 72), 0.003)
    rng = np.random.default_rng(100 + seed)
    seen = np.delete(moved, np.s_[at : at + lost]) + NOISE_UM * rng.standard_normal(samples)
    found = diagnose([recorded(drive[:samples], seen, RATE)])
    assert [f.cause for f in found.findings] == ["dropped-samples"]
    (event,) = found.findings[0].events
    assert event.size == lost
    assert abs(event.index - at) <= 1
    assert not found.unexplained.detected
