"""Noise on a recorded drive, and hum that every recording begins at the same phase of."""

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.early.hum import Row, agreeing
from tests.diagnosis.small_bench import recordings


def in_phase(size_um, hz=50.0):
    def sensor(x, t, rng):
        return x + size_um * np.sin(2.0 * np.pi * hz * (t - t[0]) + 0.7)

    return sensor


@pytest.mark.study
@pytest.mark.parametrize(("size_nm", "hz"), [(1.5, 50.0), (20.0, 60.0)])
def test_hum_that_all_repeats_have_alike_is_hum(size_nm, hz):
    found = diagnose(recordings(sensor=in_phase(1e-3 * size_nm, hz), seed=2))
    (hum,) = found.findings
    assert hum.cause == "mains-hum"
    low, high = hum.parameters["amplitude"].ci95
    assert 0.9 * low < size_nm < 1.1 * high
    assert hum.parameters["frequency"].value == pytest.approx(hz, abs=0.02)
    assert not found.unexplained.detected


@pytest.mark.parametrize(("sizes", "phases", "agree"), [
    ((5.0, 5.0, 5.0), (0.7, 0.7, 0.7), True), ((1.0, 2.0, 5.0), (0.7, 0.7, 0.7), False),
    ((5.0, 5.0, 5.0), (0.0, 1.0, 2.0), False),
])  # fmt: skip
def test_a_line_is_the_mains_only_if_all_drives_have_it_alike(sizes, phases, agree):
    time = np.arange(3000) / 2000.0
    rows = [
        Row(time, a * np.sin(2.0 * np.pi * 50.0 * time + p), 1.0, (2.0,))
        for a, p in zip(sizes, phases, strict=True)
    ]
    assert agreeing(rows, 50.0) == agree


def test_noise_on_a_recorded_drive_is_no_cause():
    rng = np.random.default_rng(7)
    sweeps = [
        s.with_(command_v=s.command_v + 0.01 / 7.5 * rng.standard_normal(s.command_v.size))
        for s in recordings(seed=4)
    ]
    found = diagnose(sweeps)
    assert found.findings == []
    assert not found.unexplained.detected
    assert any("recorded with noise of up to" in note for note in found.notes)
