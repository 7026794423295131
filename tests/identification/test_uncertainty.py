"""Bands cover the truth as often as they say; the study measures it over 200 trials."""

from __future__ import annotations

import numpy as np
import pytest
from recordings import TOP, classical, matrix

from piezo_rig.identification import identify
from piezo_rig.identification.curves import Curves
from piezo_rig.identification.smooth import learnt
from piezo_rig.studies import identification as study


def test_the_studys_actuator_is_the_textbooks():
    from reference_actuators import Sliders

    rng = np.random.default_rng(0)
    actuator = study.random_actuator(rng, 9, by_law=False)
    drive, y = study.played(actuator, [0.0, 60.0, 20.0, 70.0, -50.0, 75.0, 0.0])
    slides = actuator.dx * np.arange(1, 10)
    expected = Sliders(list(actuator.first), list(slides)).play(list(drive))
    assert y == pytest.approx(np.array(expected), abs=1e-9)


@pytest.mark.study
@pytest.mark.parametrize("number", [2, 3])
def test_bands_cover_the_truth(number):
    found = study._actuator_trials((number, 0, 10)) + study._actuator_trials((number, 1, 10))
    for kind in study.KINDS:
        assert np.mean([np.mean(f[kind]) for f in found]) > 0.82


@pytest.mark.study
@pytest.mark.parametrize("what", ["classical, chosen, truth has 12", "range, chosen, 12 uneven"])
def test_bands_cover_a_truth_that_is_off_the_grid(what):
    number = [case.what for case in study.CASES].index(what)
    found = [r for actuator in range(6) for r in study._actuator_trials((number, actuator, 1))]
    for kind in study.KINDS[:4]:
        assert np.mean([np.mean(f[kind]) for f in found if kind in f]) > 0.82


def test_the_step_between_neighbours_is_learnt():
    rng = np.random.default_rng(0)
    n, step, noise = 400, 0.03, 1e-4
    true = 1.0 + np.cumsum(step * rng.standard_normal(n))
    gram = 50.0 * np.eye(n)  # every compliance was seen by itself, fifty times
    right = 50.0 * (true + np.sqrt(noise / 50.0) * rng.standard_normal(n))
    prior = learnt(gram, right, noise, ((0, n),), true)
    assert prior.steps[0] == pytest.approx(step, rel=0.1)


def test_halves_of_bands_draw_the_same_curve():
    curves = Curves(np.array([2.0, 4.0]), np.array([1.0, 2.0, 3.0]), np.array([4.0, 8.0]),
                    np.array([1.1, 2.1, 3.1]), False)  # fmt: skip
    halved, whole, apart = curves.halved()
    assert halved.first_knots == pytest.approx([1, 2, 3, 4, 5])
    assert halved.pack(False) == pytest.approx(whole @ curves.pack(False))
    assert np.sum(apart, axis=0) == pytest.approx(0.0)


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


def test_a_law_whose_first_break_has_several_peaks_has_a_wider_interval():
    number = [case.what for case in study.CASES].index("range, chosen, truth has 27")
    case, rng = study.CASES[number], np.random.default_rng([number, 1])
    truth = study.random_actuator(rng, case.true_elements, by_law=True)
    plan = study.conditions(case.spans, 75.0, case.cycles)
    clean = {name: study.played(truth, turns) for name, turns in plan.items()}
    found = identify(study.record(clean, rng, 0.0), "range")
    slope = found.model.stage("range-dependence").parameters["slope"]
    low, high = slope.ci95
    # the likeliest peak alone is eight of its standard errors from the truth
    assert abs(slope.value - truth.slope) < 3.0 * (high - low) / 3.92
