"""One recording alone: a mount that slips and a vibration that passes are no steady noise."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from tests.diagnosis.sliders import play, recorded

RATE = 2000.0


def recording(change, seed, colour="white"):
    """Two dozen triangles of two heights, 0.5 s each; 2.5 nm of noise."""
    up = np.linspace(0.0, 1.0, 500)
    one = np.concatenate([up, up[::-1]])
    drive = np.concatenate([height * one for height in (70.0, 45.0) * 12])
    moved = play(drive, np.linspace(0.5, 36.0, 72), 0.003)
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(drive.size)
    if colour == "ar":
        for k in range(1, noise.size):
            noise[k] = 0.9 * noise[k - 1] + np.sqrt(1.0 - 0.81) * noise[k]
    seen = change(moved, np.arange(drive.size) / RATE, rng) + 2.5e-3 * noise
    return recorded(drive, seen, RATE)


def steady(x, time, rng):
    return x


def slipping(x, time, rng):
    """A mount that gives by 2 % holds until it is 40 to 80 nm behind, and then slips."""
    out, stands, most = np.empty(x.size), 0.0, 0.06
    for k, wanted in enumerate(0.02 * x):
        if abs(wanted - stands) > most:
            stands, most = wanted, rng.uniform(0.04, 0.08)
        out[k] = x[k] - (wanted - stands)
    return out


def shaken(x, time, rng):
    """8 nm at 17 Hz that come and go within two seconds."""
    return x + 8e-3 * np.exp(-0.5 * ((time - 5.2) / 0.7) ** 2) * np.sin(2 * np.pi * 17.3 * time)


@pytest.mark.study
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("effect", [slipping, shaken])
def test_what_comes_and_goes_is_unexplained_and_has_no_name(effect, seed):
    out = diagnose([recording(effect, seed)])
    assert out.findings == []
    assert out.unexplained.detected
    assert "noise is not steady" in out.unexplained.text


@pytest.mark.study
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("colour", ["white", "ar"])
def test_steady_noise_is_nothing(seed, colour):
    out = diagnose([recording(steady, seed, colour)])
    assert out.findings == []
    assert not out.unexplained.detected
