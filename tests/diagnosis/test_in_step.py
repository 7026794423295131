"""A generator and a digitizer without a common clock: repeats begin at another part of a sample."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.engine import plainly
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.groups import Groups
from piezo_rig.diagnosis.in_step import in_step, lost, out_of_step
from piezo_rig.identification import prepare
from piezo_rig.run_file.sweep import Sweep
from tests.diagnosis.sliders import play

FINER, RATE, NOISE_UM = 10, 1000.0, 2e-3
LIMITS = np.linspace(0.5, 30.0, 30)


def session(seed: int, late_s: float = 0.0) -> list[Sweep]:
    """Two drives from rest, three times each, played and moved at ten times the rate of the
    samples, which begin anywhere; ``late_s`` : by which the sensor is late.
    """
    rng, out = np.random.default_rng(seed), []
    time = np.arange(40_000) / (FINER * RATE)
    for number in range(6):
        top = (70.0, 45.0)[number % 2]
        volts = top * (1.0 - np.abs(2.0 * ((1.5 * np.maximum(time - 0.1, 0.0)) % 1.0) - 1.0))
        seen = np.interp(time - late_s, time, play(volts, LIMITS, 0.0016))
        begin = int(rng.integers(0, FINER))
        volts, seen = volts[begin::FINER], seen[begin::FINER]
        seen = seen + NOISE_UM * rng.standard_normal(seen.size)
        out.append(Sweep(
            f"sweep_{number + 1:04d}", volts, seen, RATE, 1.0, 0.0, 1.0, 1, 0.0,
            f"to {top:g} V", number // 2 + 1, "virgin", 60.0 * number, "SIMULATED",
        ))  # fmt: skip
    return out


def in_step_of(sweeps: list[Sweep]) -> tuple[Groups, Groups | None]:
    """As they were recorded, and in step."""
    data = prepare(sweeps)
    raw = group_tracks(data, sweeps)
    model = plainly(raw, Point(starting_model(raw, (), "classical"))).point.model
    found = in_step(raw, out_of_step(raw, data.tracks), model)
    return raw, found and found.groups


def test_repeats_in_step_differ_by_their_noise_alone():
    raw, found = in_step_of(session(3))
    assert found is not None
    for group, before in zip(found.groups, raw.groups, strict=True):
        apart = group.measured_um - group.measured_um.mean(axis=0)
        assert np.std(apart) == pytest.approx(np.sqrt(2 / 3) * NOISE_UM, rel=0.1)
        was = before.measured_um - before.measured_um.mean(axis=0)
        assert np.std(was) > 1.5 * np.std(apart)


def test_what_a_monitor_only_reads_is_left_as_it_is():
    """Drives that differ by what a monitor wanders, and move no actuator."""
    rng, time = np.random.default_rng(0), np.arange(4000) / RATE
    volts = 60.0 * (1.0 - np.abs(2.0 * ((1.5 * time) % 1.0) - 1.0))
    seen = play(volts, LIMITS, 0.0016)
    sweeps = [
        Sweep(
            f"sweep_{k + 1:04d}", volts + 0.002 * np.cumsum(rng.standard_normal(4000)),
            seen + NOISE_UM * rng.standard_normal(4000), RATE, 1.0, 0.0, 1.0, 1, 0.0, "to 60 V",
            k + 1, "virgin", 60.0 * k, "SIMULATED",
        ) for k in range(3)
    ]  # fmt: skip
    raw, found = in_step_of(sweeps)
    assert raw.repeats == 3
    assert found is None


@pytest.mark.study
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_nothing_is_found_in_recordings_out_of_step(seed):
    found = diagnose(session(seed))
    assert found.findings == []
    assert not found.unexplained.detected
    assert found.noise_floor_nm == pytest.approx(1e3 * NOISE_UM, rel=0.03)


@pytest.mark.study
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_a_delay_is_found_beside(seed):
    """Triangles of one frequency hardly tell it from other things that go by speed."""
    found = diagnose(session(seed, 3e-4))
    assert len(found.findings) == 1
    assert "time-skew" in (found.findings[0].cause, *found.findings[0].alternatives)
    assert not found.unexplained.detected


@given(
    at=st.sets(st.integers(0, 8), min_size=1, max_size=3), seed=st.integers(0, 99)
)
def test_a_drive_less_some_samples_is_one_that_lost_them(at, seed):
    at = [20 * k + 1 for k in at]
    whole = np.random.default_rng(seed).uniform(0.0, 75.0, 200)
    assert lost(whole, np.delete(whole, at), 1e-6)
    assert not lost(whole, whole, 1e-6)


@given(late=st.floats(0.05, 0.95), seed=st.integers(0, 99))
def test_one_that_was_sampled_elsewhere_is_not(late, seed):
    corners = np.random.default_rng(seed).uniform(0.0, 75.0, 20)
    at = np.arange(200.0)
    whole, row = (np.interp(x, np.arange(0.0, 400.0, 20.0), corners) for x in (at, at + late))
    assert not lost(whole, row, 0.01)
