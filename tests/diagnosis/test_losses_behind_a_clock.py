"""Samples lost under a smooth drive, in one recording alone, are no clock that runs off.

A base that is fitted to all of it is late before the loss and early after it.
"""

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfiltfilt

from piezo_rig.diagnosis import diagnose
from tests.diagnosis.sliders import play, recorded

RATE, SECONDS, NOISE_UM = 2000.0, 24.0, 2e-3


def smooth(seed: int, samples: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    noise = sosfiltfilt(butter(2, 2.0, fs=RATE, output="sos"), rng.standard_normal(samples + 4000))
    noise = noise[2000 : samples + 2000] / noise.std()
    return 37.0 + 35.0 * np.tanh(0.8 * noise)


@pytest.mark.study
@pytest.mark.parametrize(("seed", "lost"), [(1, 3), (4, 6)])
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


@pytest.mark.study
def test_a_second_loss_and_a_lag_behind_what_looks_like_a_clock():
    """The lag hides a part of either loss from the base, and the clock takes most of the rest."""
    rate, samples, tau_s = 5000.0, 49_500, 0.44e-3
    t = np.arange(samples + 100) / rate
    rng = np.random.default_rng(7)
    drive = sum(
        rng.uniform(0.4, 1.0) * np.sin(2.0 * np.pi * f * t + rng.uniform(0.0, 6.28))
        for f in (0.45, 0.9, 1.7, 2.4)
    )
    drive = 75.0 * (drive - drive.min()) / np.ptp(drive) * np.minimum(t / 0.6, 1.0)
    keeps = np.exp(-1.0 / (rate * tau_s))
    late = lfilter([1.0 - keeps], [1.0, -keeps], drive)
    moved = play(late, np.linspace(0.5, 36.0, 72), 0.003)
    lost = {7786: 14, 33_092: 4}
    kept = np.delete(np.arange(samples + 18), np.concatenate([
        np.arange(at, at + count) for at, count in lost.items()
    ]))  # fmt: skip
    seen = moved[kept] + 3.7e-3 * rng.standard_normal(samples)
    found = diagnose([recorded(drive[:samples], seen, rate)])
    named = {f.cause: f for f in found.findings}
    assert set(named) == {"dropped-samples", "amplifier-lag"} or (
        set(named) == {"dropped-samples", "time-skew"}
        and "amplifier-lag" in named["time-skew"].alternatives
    )
    assert [e.size for e in named["dropped-samples"].events] == list(lost.values())
    assert not found.unexplained.detected
