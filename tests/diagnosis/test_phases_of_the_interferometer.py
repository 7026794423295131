"""The interferometer's error follows its own scale, which drift moves between recordings."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.causes import named_model
from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.engine import plain_space
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.refit import refit
from piezo_rig.diagnosis.scale import at_one_phase, on_one_scale
from piezo_rig.identification import prepare
from piezo_rig.run_file import Sweep
from tests.diagnosis.sliders import play

RATE, HALF_WAVE_UM = 1000.0, 0.3164
ENDS = ((0.0, 75.0), (0.0, 50.0), (0.0, 30.0))
LIMITS, SHARE = np.sort(np.random.default_rng(8).uniform(0.3, 45.0, 80)), 0.06 / 80
BEFORE_UM = (0.02, 0.11, 0.27)  # where recordings of unknown history begin


def drive(low, high, cycles=3):
    up = np.linspace(low, high, 250, endpoint=False)
    return np.append(np.tile(np.concatenate([up, up[::-1] + (high - low) / 250]), cycles), low)


def session(rate_um_s=0.0, size_um=4e-3, history="virgin", begins_um=(0.0, 0.0, 0.0), pause_s=8.0):
    """Every drive twice from rest, read on a scale that drifts; each from where it begins."""
    rng, sweeps, start = np.random.default_rng(3), list[Sweep](), 0.0
    for repeat in (1, 2):
        for (low, high), begins in zip(ENDS, begins_um, strict=True):
            volts = drive(low, high)
            clock = start + np.arange(volts.size) / RATE
            there = play(volts, LIMITS, SHARE) + begins + rate_um_s * clock
            seen = there + size_um * np.sin(2.0 * np.pi * there / HALF_WAVE_UM + 0.4)
            seen = seen - seen[0] + 1e-3 * rng.standard_normal(volts.size)
            sweeps.append(Sweep(
                f"sweep_{len(sweeps) + 1:04d}", volts, seen, RATE, 1.0, 0.0, 1.0, 1, 0.0,
                f"{low:g}-{high:g}", repeat, history, start, "IMPORTED",
            ))  # fmt: skip
            start += volts.size / RATE + pause_s
    return sweeps


def fitted(sweeps):
    groups = group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)
    point = Point(starting_model(groups, named_model("classical"), "classical"))
    return groups, refit(plain_space(groups, point.model), point).point.model


def test_repeats_half_a_wave_apart_are_turned_to_the_phase_of_the_first():
    """158 nm of drift between repeats: the mean of both has no ripple left at all."""
    rate = 0.5 * HALF_WAVE_UM / (3 * (1501 / RATE + 8.0))
    groups, model = fitted(session(rate))
    turned = at_one_phase(groups, model)
    assert turned is not groups
    for before, after in zip(groups.groups, turned.groups, strict=True):
        apart = [g.measured_um - g.measured_um.mean(axis=1, keepdims=True) for g in (before, after)]
        then, now = (1e3 * np.std(a[0] - a[1]) for a in apart)
        assert then > 5.0  # two ripples of 4 nm against each other, and noise
        assert now == pytest.approx(np.sqrt(2.0), rel=0.15)  # noise alone, 1 nm each


@pytest.mark.study
def test_ripple_and_drift_are_named_where_the_repeats_are_half_a_wave_apart():
    rate = 0.5 * HALF_WAVE_UM / (3 * (1501 / RATE + 8.0))
    found = diagnose(session(rate))
    assert {f.cause for f in found.findings} == {"periodic-nonlinearity", "thermal-drift"}
    told = {f.cause: f.parameters for f in found.findings}
    amplitude, drift = told["periodic-nonlinearity"]["amplitude"], told["thermal-drift"]["rate"]
    assert amplitude.ci95[0] < 4.0 < amplitude.ci95[1]
    assert amplitude.value == pytest.approx(4.0, abs=0.15)
    assert drift.ci95[0] < 1e3 * rate < drift.ci95[1]
    assert not found.unexplained.detected
    assert any("another phase" in note for note in found.notes)


def test_recordings_with_one_phase_or_without_a_ripple_are_as_they_were():
    for sweeps in (session(), session(size_um=0.0), session(3e-3, size_um=0.0)):
        groups, model = fitted(sweeps)
        assert at_one_phase(groups, model) is groups
        assert on_one_scale(groups, model) is groups


def test_where_recordings_of_unknown_history_begin_is_read_off_the_ripple():
    """The reading is that in the mean over time, and no model's beginning is in it."""
    sweeps = session(history="unknown", begins_um=BEFORE_UM)
    groups, model = fitted(sweeps)
    read, true = [], []
    for g, ends, begins in zip(on_one_scale(groups, model).groups, ENDS, BEFORE_UM, strict=True):
        a, b = g.blocks[0]
        read.append(g.reads[0].scale_um)
        true.append(play(drive(*ends), LIMITS, SHARE)[a:b].mean() + begins)
    off = np.array(read) - true
    apart = (off - off[0] + 0.5 * HALF_WAVE_UM) % HALF_WAVE_UM - 0.5 * HALF_WAVE_UM
    assert np.abs(apart).max() < 0.004  # a hundredth of a period
