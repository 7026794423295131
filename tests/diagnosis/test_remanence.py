"""Recordings that begin with a quarter of the memory of the one before: named, and measured."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from small_bench import RATE, drive_of

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Elements, Maxwell, Model
from piezo_rig.diagnosis import basis, diagnose
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification.data import prepare
from piezo_rig.run_file import Sweep

LEFT = 0.25
RANGES = (30.0, 75.0, 50.0)


def body(drive, states, thresholds, weights):
    """Play operators from given states; what they are at the end."""
    out = np.empty(drive.size)
    for i, v in enumerate(drive):
        states = np.minimum(np.maximum(states, v - thresholds), v + thresholds)
        out[i] = 0.09 * v + weights @ states
    return out, states


@pytest.fixture(scope="module")
def session():
    """Three rounds of three ranges in another order each, the first recording virgin."""
    rng = np.random.default_rng(8)
    thresholds = np.sort(rng.uniform(0.2, 36.0, 60))
    weights = rng.uniform(0.5, 1.5, 60) * 1.1e-3
    out, clock, states = [], 10.0, np.zeros(60)
    for repeat in range(1, 4):
        for k in rng.permutation(len(RANGES)):
            drive = drive_of(0.0, RANGES[k], cycles=1)
            x, states = body(drive, LEFT * states, thresholds, weights)
            x = x - x[0] + 2e-3 * rng.standard_normal(x.size)
            out.append(Sweep(
                name=f"sweep_{len(out) + 1:04d}", command_v=(drive - 75.0) / 7.5,
                sensor_v=-x / 15.48, sample_rate=RATE, gain=7.5, offset_v=75.0,
                sensitivity_um_per_v=15.48, polarity=-1, zero_v=-x[0] / 15.48,
                condition=f"0-{RANGES[k]:g}", repeat=repeat, history="virgin", start_time=clock,
                origin="IMPORTED",
            ))
            clock += 20.0
    return out


@pytest.mark.study
def test_what_is_left_of_large_recordings_is_named_alone_and_measured(session):
    found = diagnose(session)
    assert [f.cause for f in found.findings] == ["remanence"]
    assert found.findings[0].alternatives == []
    part = found.findings[0].parameters["fraction"]
    half = 0.5 * (part.ci95[1] - part.ci95[0])
    assert abs(part.value - LEFT) < 2.0 * half
    assert half < 0.02
    # recordings that were played after different ones count as repeats once that is known
    assert found.noise_floor_nm == pytest.approx(2.0, rel=0.1)
    assert found.rungs[-1].rms_nm < 2.3
    assert not found.unexplained.detected


def test_bands_begin_with_what_is_left(session):
    groups = group_tracks(prepare(session, first_rises=True, clipped=True), session)
    table = Elements.from_curve(np.linspace(5.0, 75.0, 12), np.linspace(0.1, 0.15, 12))
    model = Model((Maxwell.of(table),)).with_stage(CAUSES["remanence"].of(None, fraction=LEFT))
    for group in groups.groups:
        whole = group.predicted(model)
        by_bands = (1.0 / table.slopes) @ basis.bands(model, group)
        assert by_bands - by_bands[0] == pytest.approx(whole - whole[0], abs=1e-9)
        virgin = group.predicted(model.without("remanence"))
        assert np.max(np.abs(whole - virgin)) > 0.01


def test_a_prediction_of_some_recordings_is_of_what_they_were_played_after(session):
    groups = group_tracks(prepare(session, first_rises=True, clipped=True), session)
    table = Elements.from_curve(np.linspace(5.0, 75.0, 12), np.linspace(0.1, 0.15, 12))
    model = Model((Maxwell.of(table),)).with_stage(CAUSES["remanence"].of(None, fraction=LEFT))
    for group in groups.groups:
        rows = range(group.repeats)
        every = np.mean([group.predicted_of(model, [r]) for r in rows], axis=0)
        assert every == pytest.approx(group.predicted(model), abs=1e-9)
        alike = replace(group, measured_um=np.array([group.predicted_of(model, [r]) for r in rows]))
        assert np.ptp(alike.of_one_history(model).measured_um, axis=0).max() < 1e-9
