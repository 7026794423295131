"""Bands cover the truth as often as they say; the study measures it over 200 trials."""

from __future__ import annotations

import numpy as np
import pytest
from recordings import TOP, classical, matrix

from piezo_rig.identification import identify
from piezo_rig.studies import identification as study


def test_the_studys_actuator_is_the_textbooks():
    from reference_actuators import Sliders

    rng = np.random.default_rng(0)
    actuator = study.random_actuator(rng, 9, by_law=False)
    drive, y = study.played(actuator, [0.0, 60.0, 20.0, 70.0, -50.0, 75.0, 0.0])
    slides = actuator.dx * np.arange(1, 10)
    expected = Sliders(list(actuator.first), list(slides)).play(list(drive))
    assert y == pytest.approx(np.array(expected), abs=1e-9)


@pytest.mark.parametrize("number", [2, 3])
def test_bands_cover_the_truth(number):
    found = study._actuator_trials((number, 0, 10)) + study._actuator_trials((number, 1, 10))
    for kind in study.KINDS:
        assert np.mean([np.mean(f[kind]) for f in found]) > 0.82


def test_few_sweeps_make_wide_bands():
    few, many = (
        identify(matrix(classical, spans, 2, noise=0.005), "classical", elements=7).bands
        for spans in ((9.0, TOP), (5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, TOP))
    )
    assert np.mean(np.ptp(few.first_um, axis=1)) > 1.3 * np.mean(np.ptp(many.first_um, axis=1))


def test_sweeps_that_disagree_make_wide_bands():
    same = matrix(classical, (6.0, 8.0, 10.0, TOP), 2, noise=0.005)
    other = [
        s.with_(sensor_v=s.sensor_v * (1 + 0.01 * (-1) ** i)) for i, s in enumerate(same)
    ]  # scales that differ by a percent
    one, two = (identify(s, "classical", elements=7).bands for s in (same, other))
    assert one.dispersion < 3 < two.dispersion
    assert np.mean(np.ptp(two.first_um, axis=1)) > 2 * np.mean(np.ptp(one.first_um, axis=1))


def test_bands_are_in_the_model_file():
    found = identify(matrix(classical, (8.0, TOP), 2, noise=0.005), "classical")
    stored = found.model.provenance["bands95"]
    assert np.shape(stored["first_rise_um"]) == (len(stored["drive_v"]), 2)
    assert found.model.provenance["condition_number"] > 1
