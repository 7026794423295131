"""Corners that a baseline is late at look like outliers; beside a better model there are none."""

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.early import HUM, Early, never_outliers
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification import prepare
from tests.diagnosis.sliders import play, recorded
from tests.diagnosis.spaces import begun

RATE, NOISE_UM = 2000.0, 0.003
SLIDERS = np.geomspace(0.4, 36.0, 40)


def triangles(spikes=()):
    up = np.linspace(0.0, 60.0, 400, endpoint=False)
    drive = np.tile(np.concatenate([up, 60.0 - up]), 4)
    seen = play(drive, SLIDERS, 0.002)
    seen += NOISE_UM * np.random.default_rng(5).standard_normal(drive.size)
    seen[list(spikes)] += 0.4
    return [recorded(drive, seen, RATE, "virgin")]


def beside_a_fit(sweeps, *found):
    data = group_tracks(prepare(sweeps), sweeps)
    return never_outliers(data, found, begun(triangles())[1].model)


def early(cause):
    return Early(cause, 1e-6, {}, None)


def test_those_of_the_baseline_are_given_up():
    assert beside_a_fit(triangles(), early("outliers")) == []


def test_those_that_are_there_are_kept():
    assert beside_a_fit(triangles([700, 1430, 2205]), early("outliers")) is None


def test_nothing_is_given_up_where_there_are_none_or_a_hum_is_in_the_way():
    assert beside_a_fit(triangles()) is None
    assert beside_a_fit(triangles(), early("outliers"), early(HUM)) is None


@pytest.mark.study
@pytest.mark.parametrize("seed", [1, 2])
def test_a_loss_beside_a_clock_is_counted_and_leaves_no_outliers(seed):
    """Sums of sines between ramps, each recorded once: 2 samples for 3, and two spikes, before."""
    ppm, lost, out = 125.0, 3, []
    for k in range(3):
        rng = np.random.default_rng(10 * seed + k)
        time = np.arange(round(8.0 * RATE)) / RATE
        wave = sum(np.sin(2.0 * np.pi * (f * time + rng.random())) for f in (0.7, 1.3, 2.9, 6.1))
        wave = 37.5 + 37.0 * wave / np.abs(wave).max()
        begin, end = (np.linspace(0.0, wave[i], 250) for i in (0, -1))
        drive = np.concatenate([begin, wave, end[::-1], np.zeros(50)])
        moved = play(drive, SLIDERS, 0.002)
        at = np.arange(drive.size) / (1.0 + 1e-6 * ppm)
        at += np.where(np.arange(drive.size) >= 7000, lost, 0) * (k == 1)
        seen = np.interp(at, np.arange(drive.size), moved)
        seen += NOISE_UM * rng.standard_normal(drive.size)
        out.append(recorded(drive, seen, RATE, "unknown", k, f"sum {k}"))
    found = diagnose(out)
    told = {f.cause: f for f in found.findings}
    assert set(told) == {"dropped-samples", "clock-ratio"}
    assert told["dropped-samples"].parameters["count"].value == lost
    assert told["clock-ratio"].parameters["ppm"].value == pytest.approx(ppm, abs=5.0)
