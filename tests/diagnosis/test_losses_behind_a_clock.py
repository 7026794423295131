"""Samples lost under a smooth drive, in one recording alone, are no clock that runs off.

A base that is fitted to all of it is late before the loss and early after it.
"""

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from piezo_rig.diagnosis import diagnose
from tests.diagnosis.sliders import play, recorded

RATE, SECONDS, NOISE_UM = 2000.0, 24.0, 2e-3


def smooth(seed: int, samples: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    noise = sosfiltfilt(butter(2, 2.0, fs=RATE, output="sos"), rng.standard_normal(samples + 4000))
    noise = noise[2000 : samples + 2000] / noise.std()
    return 37.0 + 35.0 * np.tanh(0.8 * noise)


@pytest.mark.parametrize(("seed", "lost"), [
    (1, 3), pytest.param(4, 6, marks=pytest.mark.study),
])  # fmt: skip
def test_a_loss_under_a_smooth_drive_is_found_where_it_is(seed, lost):
    samples = int(RATE * SECONDS)
    drive = smooth(seed, samples + 100)
    third = samples // 3
    at = third + int(np.argmax(np.abs(np.gradient(drive[third : 2 * third]))))
    up = np.linspace(0.0, 75.0, 1000)
    before = np.concatenate([up, up[::-1], np.linspace(0.0, drive[0], 500)])
    moved = play(np.concatenate([before, drive]), np.linspace(0.5, 36.0, 72), 0.003)[before.size :]
    kept = np.delete(np.arange(samples + lost), np.s_[at : at + lost])
    rng = np.random.default_rng(100 + seed)
    seen = (moved - moved[0])[kept] + NOISE_UM * rng.standard_normal(samples)
    found = diagnose([recorded(drive[:samples], seen, RATE, "unknown")])
    assert [f.cause for f in found.findings] == ["dropped-samples"]
    (event,) = found.findings[0].events
    assert event.size == lost
    assert abs(event.time_s - at / RATE) < 3.0 / RATE
    assert not found.unexplained.detected
