"""Lines that a drive makes of itself are no hum, wherever they fall."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from piezo_rig.causes import named_model
from piezo_rig.chain import Parameter
from piezo_rig.diagnosis.early import Early, hum_again, hum_behind
from piezo_rig.diagnosis.early.hum import Row, _line, find_hum, hum_of_residual
from piezo_rig.diagnosis.engine import plain_space
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.periods import period_s
from piezo_rig.diagnosis.refit import refit
from piezo_rig.identification import prepare
from piezo_rig.run_file import Sweep
from tests.more import first_of

RATE, SECONDS, LEVEL, COUNT = 2000.0, 12.0, 2e-3, 24
TIME = np.arange(round(RATE * SECONDS)) / RATE


def sines(*lines_hz):
    """A drive between 5 and 70 V."""
    drive = sum(np.sin(2.0 * np.pi * f * TIME + 1.7 * f) for f in lines_hz)
    return 5.0 + 65.0 * (drive - drive.min()) / np.ptp(drive)


def played(drive):
    """A few sliders, in plain numpy."""
    states, weights = np.full(12, drive[0]), np.linspace(8e-3, 2e-3, 12)
    thresholds, out = np.linspace(1.0, 30.0, 12), np.empty(drive.size)
    for i, v in enumerate(drive):
        states = np.minimum(np.maximum(states, v - thresholds), v + thresholds)
        out[i] = 0.1 * v + weights @ states
    return out


def recorded(drive, moved, seed):
    seen = moved - moved[0] + 2e-3 * np.random.default_rng(seed).standard_normal(moved.size)
    return Sweep("sweep_0001", drive, seen, RATE, 1.0, 0.0, 1.0, 1, 0.0, "", 1, "unknown", 0.0,
                 "IMPORTED")  # fmt: skip


def groups_of(*sweeps):
    return group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)


def fitted(groups, point):
    return refit(plain_space(groups, point.model), point).point


def base_of(groups):
    return fitted(groups, Point(starting_model(groups, named_model("classical"), "classical")))


def baseline(groups):
    return base_of(groups).model


@pytest.mark.parametrize(("lines_hz", "seconds"), [
    ((3.0, 4.0, 10.0), 1.0), ((5.0, 12.5), 0.4), ((2.0, 3.0 * np.sqrt(2.0)), None),
])  # fmt: skip
def test_after_how_long_a_drive_comes_back(lines_hz, seconds):
    found = period_s(SimpleNamespace(drive_v=sines(*lines_hz), time_s=TIME))
    assert found is None if seconds is None else found == pytest.approx(seconds, abs=1.5 / RATE)


def test_a_wandering_drive_does_not_come_back():
    drive = np.cumsum(np.random.default_rng(3).standard_normal(TIME.size))
    assert period_s(SimpleNamespace(drive_v=drive, time_s=TIME)) is None


@pytest.mark.parametrize("lines_hz", [(50.0,), (20.0,), (3.0, 4.0, 6.0, 10.0, 21.0, 24.0)])
def test_what_a_model_that_is_wrong_by_a_share_leaves_is_no_hum(lines_hz):
    drive = sines(*lines_hz)
    moved = played(drive)
    groups = groups_of(recorded(drive, moved, 1))
    stretched = recorded(drive, 1.03 * moved, 1)  # a sensor that shows too much
    found = find_hum(groups_of(stretched), baseline(groups))
    assert found is None or found.p_value * COUNT > LEVEL


@pytest.mark.parametrize("hz", first_of(1, [49.98, 60.03]))
def test_a_hum_beside_several_sines_is_found_all_the_same(hz):
    drive = sines(3.0, 4.0, 6.0, 10.0, 21.0, 24.0)
    hum = 4e-3 * np.sin(2.0 * np.pi * hz * TIME + 0.4)
    groups = groups_of(recorded(drive, played(drive) + hum, 2))
    found = find_hum(groups, baseline(groups))
    assert found.p_value * COUNT < LEVEL
    assert abs(found.frequency - hz) < 0.02
    assert found.amplitude_nm == pytest.approx(4.0, rel=0.15)


def test_a_recording_that_cannot_tell_a_hum_from_its_own_lines_does_not_count():
    noise = np.random.default_rng(5).standard_normal((2, 1000))
    time = TIME[:1000]
    tells = Row(time, noise[0] + np.sin(2.0 * np.pi * 60.0 * time), 1.0, (40.0,), (40.0,))
    does_not = Row(time, noise[1] + 9.0 * np.sin(2.0 * np.pi * 60.0 * time), 1.0, (30.0,), (30.0,))
    at = np.array([60.0, 50.0])
    alone, _ = _line([tells], at)
    score, count = _line([tells, does_not], at)
    assert score[0] == alone[0]
    assert list(count) == [1.0, 2.0]  # it has nothing of its own at 50 Hz
    assert score[1] > alone[1]


def test_lines_of_drives_do_not_move_the_frequency_of_a_hum():
    sweeps = []
    for k, hz in enumerate([21.0, *6 * [30.0], *6 * [60.0]]):
        now = TIME[: round((2.0 if k == 0 else 0.5 + 0.02 * k) * RATE)]
        drive = sines(hz)[: now.size]
        hum = 2e-3 * np.sin(2.0 * np.pi * 60.2 * now + 0.9 * k)
        sweeps.append(recorded(drive, played(drive) + hum, k))
    groups = groups_of(*sweeps)
    found = find_hum(groups, baseline(groups))
    assert found.frequency == pytest.approx(60.2, abs=0.05)


@pytest.mark.parametrize("hz", [49.5, 60.5])
def test_what_is_further_off_than_mains_ever_are_is_no_hum(hz):
    """A pump, or a fan: a line that has no name here. In 2 s it is hardly another frequency."""
    short = TIME < 2.0
    drive = sines(3.0, 4.0, 10.0)[short]
    line = 4e-3 * np.sin(2.0 * np.pi * hz * TIME[short] + 0.4)
    groups = groups_of(recorded(drive, played(drive) + line, 2))
    found = find_hum(groups, baseline(groups))
    assert found is None or found.p_value * COUNT > LEVEL


@pytest.mark.study
def test_a_line_elsewhere_is_another_hum_beside_a_better_model():
    drive = sines(3.0, 4.0, 10.0)
    hum = 4e-3 * np.sin(2.0 * np.pi * 50.02 * TIME)
    groups = groups_of(recorded(drive, played(drive) + hum, 3))
    told = Early("mains-hum", 1e-20, {
        "frequency": Parameter(60.0, "Hz", (59.999, 60.001)),
        "amplitude": Parameter(3.0, "nm", (2.9, 3.1)),
    }, groups)  # fmt: skip
    again = hum_again(groups, told, base_of(groups), fitted, LEVEL, COUNT)
    assert abs(again.parameters["frequency"].value - 50.02) < 0.02
    assert again.parameters["amplitude"].value == pytest.approx(4.0, rel=0.15)


@pytest.mark.parametrize("size_nm", first_of(1, [2.0, 4.0]))
def test_what_a_base_had_taken_of_a_late_hum_is_given_back(size_nm):
    """In step with every repeat: a base of many elements follows some of it in few loops."""
    short = TIME < 2.0
    drive = 35.0 * (1.0 - np.cos(2.0 * np.pi * 3.0 * TIME[short])) * (0.4 + 0.3 * TIME[short])
    hum = 1e-3 * size_nm * np.sin(2.0 * np.pi * 50.0 * TIME[short] + 0.4)
    groups = groups_of(*(recorded(drive, played(drive) + hum, seed) for seed in (1, 2)))
    base = base_of(groups)
    (beside_it,) = [found for found in [hum_of_residual(groups, base.model)] if found]
    assert beside_it.amplitude_nm < 0.9 * size_nm
    late = hum_behind(groups, base, fitted, LEVEL, COUNT)
    assert late.parameters["amplitude"].value == pytest.approx(size_nm, rel=0.05)
    low, high = late.parameters["amplitude"].ci95
    assert low < size_nm < high
