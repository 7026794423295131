"""One recording alone: a mount that slips and a vibration that passes are no steady noise."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.bursts import bursts
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification import identify, prepare
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


@pytest.mark.parametrize("knocked", [False, True])
def test_knocks_are_seen_beside_what_a_model_lacks(knocked):
    """Rings of 20 nm that die away within a quarter of a second, beside 4 nm that no model of
    elements has.
    """
    rng, places = np.random.default_rng(3), (1.9, 4.2, 6.3)
    ends = np.concatenate([[5.0], rng.uniform(10.0, 75.0, 60)])
    at_s = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(ends)) / 250.0)])
    time = np.arange(int(8.0 * RATE)) / RATE
    drive = np.interp(time, at_s, ends)
    seen = play(drive, np.linspace(0.5, 36.0, 72), 0.003)
    seen += 4e-3 * np.sin(2.0 * np.pi * drive / 31.0) * np.sin(2.0 * np.pi * time / 3.1)
    seen += 3e-3 * rng.standard_normal(time.size)
    for place in places if knocked else ():
        since = np.maximum(time - place, 0.0)
        seen += 20e-3 * np.exp(-since / 0.2) * np.sin(2.0 * np.pi * 21.0 * since)
    sweeps = [recorded(drive, seen, RATE)]
    groups = group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)
    found = bursts(groups, identify(sweeps, "classical").model)
    assert (found is not None) == knocked
    if found is not None:
        assert found.rms_nm > 0.8
        assert all(any(p - 0.2 < t < p + 0.4 for p in places) for _, t in found.at)
