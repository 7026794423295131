"""Least squares: clean data come back exactly, noisy data within their bands."""

from __future__ import annotations

import numpy as np
import pytest
from recordings import DX, FIRST, FIRST_TOP, TOP, K, classical, lawful, matrix, sweep
from small_models import LAWS

from piezo_rig.identification import identify

SPANS = (6.0, 8.0, 10.0, FIRST_TOP)


def springs_of(stage, n):
    return stage.elements.k_v_per_um[:n]


def test_a_classical_actuator_comes_back_exactly():
    turns = [0.0, TOP, 0.0, TOP, 0.0]
    found = identify([sweep(*classical(turns))], "classical", elements=7)
    assert found.fitted.max_nm < 1e-9 * 2100
    table = found.model.maxwell.elements
    assert table.k_v_per_um == pytest.approx(K, abs=1e-6)
    assert table.slides_at_um[:-1] == pytest.approx(DX * np.arange(1, 7), abs=1e-6)
    # and on a drive that was never measured
    drive, y = classical([0.0, 10.0, 4.0, 9.0, -5.0, 11.0])
    again = found.model.simulate(np.arange(drive.size) / 5e3, drive)
    assert np.max(np.abs(again - y)) < 1e-9 * np.ptp(y)


def test_thresholds_at_equal_drives_come_back_too():
    springs = [1.1, 0.5, 0.4, 0.3, 0.2, 4.0]
    slopes = np.cumsum(springs[::-1])[::-1]
    slides = np.cumsum(2.5 / slopes)  # one element gives way every 2.5 V
    drive, y = classical([0.0, 15.0, -15.0, 15.0], 150, springs, slides)
    found = identify([sweep(drive, y)], "classical")
    assert found.fitted.max_nm < 1e-6 * np.ptp(y)
    assert found.model.maxwell.elements.k_v_per_um == pytest.approx(springs, abs=1e-6)
    assert found.model.maxwell.elements.slides_at_um[:-1] == pytest.approx(slides[:-1], abs=1e-6)


@pytest.mark.parametrize("name", ["initiation", "range", "extremum", "range-extremum", "direction"])
def test_laws_come_back_exactly(name):
    law, stages = LAWS[name]
    sweeps = matrix(lambda turns: lawful(turns, law), spans=SPANS, cycles=2, top=FIRST_TOP)
    found = identify(sweeps, name)
    assert found.fitted.max_nm < 1e-9 * 3000
    assert springs_of(found.model.stage("initiation-stage"), 6) == pytest.approx(
        FIRST[:6], abs=1e-6
    )
    for id, values in stages.items():
        for parameter, value in values.items():
            assert found.model.stage(id)[parameter] == pytest.approx(value, abs=1e-6)


def test_a_model_that_is_too_rich_finds_nothing_to_add():
    sweeps = matrix(classical, spans=(6.0, 9.0, TOP), cycles=2)
    found = identify(sweeps, "range")
    assert abs(found.model.stage("range-dependence")["slope"]) < 1e-6
    assert found.fitted.max_nm < 1e-5


def test_with_noise_the_error_is_the_noise_and_the_law_is_in_its_band():
    law, _ = LAWS["range"]
    sweeps = matrix(lambda t: lawful(t, law), noise=0.005, spans=SPANS, top=FIRST_TOP)
    found = identify(sweeps, "range", elements=7)
    assert found.held_out_kind == "condition"
    assert 4.8 < found.fitted.rms_nm < 5.6
    assert found.rms_nm < 6.5
    slope = found.model.stage("range-dependence").parameters["slope"]
    assert slope.ci95[0] < slope.value < slope.ci95[1]
    assert slope.value == pytest.approx(0.03, rel=0.15)
    assert found.bands.condition_number > 1
    inside = (found.bands.first_um[:, 0] <= found.bands.first_um[:, 1]).all()
    assert inside


def test_more_structure_predicts_held_out_data_better():
    law, _ = LAWS["range"]
    sweeps = matrix(lambda t: lawful(t, law), noise=0.002, spans=SPANS, cycles=2, top=FIRST_TOP)
    errors = [identify(sweeps, n).rms_nm for n in ("classical", "initiation", "range")]
    assert errors[0] > errors[1] > errors[2]


def test_history_unknown_and_carried():
    turns = [0.0, TOP, 0.0, TOP, 0.0, TOP, 0.0]
    drive, y = classical(turns)
    middle = 137  # begins on the way, with an offset of its own
    unknown = sweep(drive[middle:], y[middle:] + 3.0, history="unknown")
    found = identify([unknown], "classical")
    assert found.fitted.max_nm < 1e-6
    assert found.fitted.samples < unknown.samples
    assert any("history unknown" in note for note in found.left_out)
    parts = [sweep(drive[:250], y[:250]), sweep(drive[250:], y[250:] - 1.0, history="carried")]
    assert identify(parts, "classical").fitted.max_nm < 1e-6


def test_an_amplitude_that_grows_is_used_where_its_memory_is_known():
    drive, y = classical([0.0, 4.0, -4.0, 8.0, -8.0, 12.0, -12.0, 5.0])
    found = identify([sweep(drive, y, history="unknown")], "classical")
    assert found.fitted.max_nm < 1e-3


def test_the_same_data_give_the_same_bytes(tmp_path):
    from piezo_rig.identification import save_model

    sweeps = matrix(classical, spans=(8.0, TOP), cycles=2, noise=0.003)
    files = [
        save_model(identify(sweeps, "initiation").model, tmp_path / n).read_bytes() for n in "ab"
    ]
    assert files[0] == files[1]


def test_noise_on_the_recorded_drive_is_taken_as_it_comes():
    rng = np.random.default_rng(5)
    drive, _ = classical([0.0, TOP, 0.0, TOP, 0.0], 300)
    drive = drive + 0.002 * rng.standard_normal(drive.size)
    from reference_actuators import Sliders

    y = np.array(Sliders(K, DX * np.arange(1, 8)).play(list(drive)))
    found = identify([sweep(drive, y)], "classical")
    assert found.fitted.max_percent < 0.05


def test_a_first_rise_from_rest_is_used_though_history_is_unknown():
    law, _ = LAWS["initiation"]
    drive, y = lawful([0.0, FIRST_TOP, 0.0, FIRST_TOP, 0.0], law)
    found = identify([sweep(drive, y + 2.0, history="unknown")], "initiation")
    assert found.fitted.max_nm < 1e-6
    assert springs_of(found.model.stage("initiation-stage"), 6) == pytest.approx(
        FIRST[:6], abs=1e-6
    )
    assert any("begins at rest" in note for note in found.left_out)
