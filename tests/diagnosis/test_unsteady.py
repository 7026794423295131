"""Gains that differ between recordings are no noise; noise of any colour is no gain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.fit import starting_model
from piezo_rig.diagnosis.groups import group_tracks
from piezo_rig.diagnosis.noise import Spectrum
from piezo_rig.diagnosis.unexplained import Unexplained, unexplained
from piezo_rig.diagnosis.unsteady import unsteady
from piezo_rig.diagnosis.whitening import CellWhitener
from piezo_rig.identification import prepare
from piezo_rig.run_file.sweep import Sweep

RATE, NOISE_UM = 1000.0, 2e-3


def play(volts: np.ndarray) -> np.ndarray:
    """Thirty sliders of one threshold each after a spring, from rest."""
    r = np.linspace(0.5, 30.0, 30)[:, None]
    out = np.empty((r.size, volts.size))
    x = np.zeros(r.size)
    for k, v in enumerate(volts - volts[0]):
        x = np.clip(x, v - r[:, 0], v + r[:, 0])
        out[:, k] = x
    return 0.08 * (volts - volts[0]) + 0.0016 * out.sum(axis=0)


def noise(rng: np.random.Generator, n: int, colour: str) -> np.ndarray:
    white = rng.standard_normal(n)
    if colour == "white":
        return white
    ar = lfilter([1.0], [1.0, -0.95], rng.standard_normal(n + 500))[500:]
    return 0.5 * white + 0.25 * ar


def session(seed: int, colour: str, gain, samples: int = 4000) -> list[Sweep]:
    """Two drives, three times each; ``gain`` : of recording and time, what the sensor shows."""
    rng, out, time = np.random.default_rng(seed), [], np.arange(samples) / RATE
    for number in range(6):
        top = (70.0, 45.0)[number % 2]
        volts = top * (1.0 - np.abs(2.0 * ((1.5 * time) % 1.0) - 1.0))
        moved = play(volts) * (1.0 + gain(number, 60.0 * number + time))
        out.append(Sweep(
            f"sweep_{number + 1:04d}", volts, moved + NOISE_UM * noise(rng, time.size, colour),
            RATE, 1.0, 0.0, 1.0, 1, 0.0, f"to {top:g} V", number // 2 + 1, "virgin",
            60.0 * number, "SIMULATED",
        ))  # fmt: skip
    return out


@pytest.mark.parametrize("colour", ["white", "ar"])
@pytest.mark.parametrize("gain", [
    lambda number, time: 0.004 * (number >= 4), lambda number, time: 0.006 * np.sin(0.9 * time),
], ids=["a step", "a wave"])  # fmt: skip
def test_what_follows_the_displacement_is_unexplained(colour, gain):
    found = diagnose(session(5, colour, gain)).unexplained
    assert found.detected
    assert "is not steady" in found.text
    assert {"displacement", "clock"} <= set(found.depends_on)


@pytest.mark.parametrize("colour", ["white", "ar"])
@pytest.mark.parametrize("seed", [1, 2])
def test_noise_is_not(colour, seed):
    assert "is not steady" not in diagnose(session(seed, colour, lambda *_: 0.0)).unexplained.text


def test_what_all_repeats_agree_on_is_unexplained_whatever_it_looks_like():
    """Errors of recordings that were left out, against what their repeats differ by."""
    plain = diagnose(session(7, "white", lambda *_: 0.0))
    assert not plain.unexplained.detected
    space, last, floor = plain.workings.space, plain.workings.last, plain.noise_floor_nm

    def of(held_out_nm: float) -> Unexplained:
        return unexplained(space, last, floor, 0.0, np.random.default_rng(0), held_out_nm)

    assert not of(1.1 * floor).detected
    found = of(2.0 * floor)
    assert found.detected
    assert found.rms_nm == pytest.approx(np.sqrt(3.0) * floor)
    assert found.depends_on


def test_where_nothing_moves_nothing_is_unsteady():
    sweeps = session(1, "white", lambda *_: 0.0)
    groups = group_tracks(prepare(sweeps), sweeps)
    model = starting_model(groups, (), "classical")
    still = groups.with_([replace(g, drive_v=np.full_like(g.drive_v, 5.0)) for g in groups.groups])
    white = CellWhitener(Spectrum(np.array([1e-6, 0.5]), np.log([4e-6, 4e-6]), np.zeros(2)))
    found = unsteady(still, white, model)
    assert found.p_value == 1.0
    assert found.rms_nm == 0.0
