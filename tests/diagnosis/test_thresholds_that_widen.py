"""Loops that open with speed by thresholds that all widen: large, and beside other effects."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Elements, Maxwell, Model
from piezo_rig.diagnosis import basis, diagnose
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification import prepare
from piezo_rig.run_file import Sweep

RATE, NOISE_UM = 2000.0, 3e-3
SPEEDS = (1.0, 10.0, 4.0, 20.0)  # triangles per second
BACK_S = 2e-3  # within which the speed is followed


def operators(drive, wider_v, thresholds, weights):
    """A spring of 0.08 um/V and play operators whose thresholds grow by ``wider_v`` (n,)."""
    out, state = np.empty(drive.size), np.zeros(thresholds.size)
    for k, (v, more) in enumerate(zip(drive, wider_v, strict=True)):
        r = thresholds + more
        state = np.clip(state, v - r, v + r)
        out[k] = 0.08 * v + weights @ state
    return out


def session(seed, volts_at_300, samples=4000):
    """Four speeds, twice each, from rest; thresholds widen in proportion to the speed."""
    rng, out = np.random.default_rng(seed), []
    thresholds = np.sort(rng.uniform(1.0, 34.0, 33))
    weights = rng.uniform(0.5, 1.5, 33) * 0.0012
    time = np.arange(samples) / RATE
    for number in range(2 * len(SPEEDS)):
        hertz = SPEEDS[number % len(SPEEDS)]
        drive = 68.0 * (1.0 - np.abs(2.0 * ((hertz * time) % 1.0) - 1.0))
        speed, now = np.empty(drive.size), 0.0
        for k, step in enumerate(np.abs(np.diff(drive, prepend=0.0)) * RATE):
            now += (step - now) * (1.0 - np.exp(-1.0 / RATE / BACK_S))
            speed[k] = now
        moved = operators(drive, volts_at_300 * speed / 300.0, thresholds, weights)
        out.append(Sweep(
            f"sweep_{number + 1:04d}", drive, moved + NOISE_UM * rng.standard_normal(drive.size),
            RATE, 1.0, 0.0, 1.0, 1, 0.0, f"{hertz:g} Hz", number // len(SPEEDS) + 1, "virgin",
            10.0 * number, "SIMULATED",
        ))  # fmt: skip
    return out


@pytest.mark.parametrize("widens", [0.0, 1.0, 2.0])
def test_a_prediction_is_the_sum_of_its_bands(widens):
    """What elements do about a model with wide thresholds is what they do in it."""
    sweeps = session(0, 0.5)
    table = Elements.from_curve(np.linspace(2.0, 75.0, 15), np.linspace(0.08, 0.13, 15))
    rate = CAUSES["rate-dependence"].of(
        None, lag_um=0.05, exponent=0.9, window_s=2e-3, widens=widens, um_per_v=0.1, opens_um=0.8
    )
    model = Model((Maxwell.of(table),)).with_stage(rate)
    for group in group_tracks(prepare(sweeps, first_rises=True), sweeps).groups:
        drag = group.predicted(model.with_stage(rate.with_values(lag_um=0.0)))
        drag = 0.0 if widens else group.predicted(model) - drag  # it is behind the elements
        whole = group.predicted(model) - drag
        by_bands = (1.0 / table.slopes) @ basis.bands(model, group)
        assert by_bands - by_bands[0] == pytest.approx(whole - whole[0], abs=1e-9)


@pytest.mark.study
@pytest.mark.parametrize("volts", [pytest.param(0.15, marks=pytest.mark.study), 0.5])
def test_a_large_one_is_named_alone_down_to_the_noise(volts):
    out = diagnose(session(1, volts))
    assert [f.cause for f in out.findings] == ["rate-dependence"]
    rungs = [rung.rms_nm for rung in out.rungs]
    assert rungs[0] > 3.0 * 1e3 * NOISE_UM
    assert rungs[-1] < 1.1 * 1e3 * NOISE_UM
    assert not out.unexplained.detected
