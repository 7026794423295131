"""The kernel against slow actuators that share no code with it."""

from __future__ import annotations

import numpy as np
import pytest
from reference_actuators import Branching, Sliders
from small_models import DX, FIRST, LAWS, K, lawful, play, ride, table

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Elements, Maxwell, Model, half_loops
from piezo_rig.errors import InputError


def drives():
    rng = np.random.default_rng(7)
    t = np.linspace(0, 6, 700)
    yield "triangle", ride([0, 12, 0, 12, 0], 37)
    yield "bipolar", ride([0, 9, -9, 9, -9, 3, -14, 14], 41)
    yield "decaying sine", 12 * np.exp(-0.3 * t) * np.sin(2 * np.pi * t)
    yield "growing", 2 * t * np.sin(2 * np.pi * t)
    yield "noise", np.cumsum(rng.standard_normal(900)) / 3
    yield "holds", np.repeat(rng.uniform(-10, 10, 30), 5)
    yield "noisy triangle", ride([0, 12, 0, 12], 200) + 0.02 * rng.standard_normal(601)
    yield "starts at 75 V", ride([75, 60, 75, 55, 80], 33)
    yield "coarse", ride([0, 14, 0, 10, 2, 14], 1)


@pytest.mark.parametrize(("name", "drive"), list(drives()))
def test_classical_is_springs_and_sliders(name, drive):
    model = Model((Maxwell.of(table(K)),))
    expected = np.array(Sliders(K, DX * np.arange(1, 8)).play(list(drive)))
    assert play(model, drive) == pytest.approx(expected, abs=2e-12)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize(
    "turns",
    [
        [0, 12, 0, 12, 0, 5, 0],
        [0, 10, 4, 10, 4, 14, 0, 14],  # a minor loop, then beyond the largest past drive
        [0, 10, -4, 6, -12, 12, -1],  # bipolar, over the mirror image of the largest drive
        [0, 9, 2, 7, 3, 6, 4, 5, 0],  # nested, closed one after the other
        [0, 15, 12, 15, 12, 15, 0],
    ],
)
def test_laws_branch_by_branch(name, turns):
    drive = ride([float(v) for v in turns], 23)
    expected = Branching(DX, FIRST, K, LAWS[name][0]).play([float(v) for v in turns], 23)
    assert play(lawful(name), drive) == pytest.approx(np.array(expected), abs=1e-12)


def test_one_element_is_a_straight_line():
    model = Model((Maxwell.of(Elements(np.array([8.0]), np.array([1.0]))),))
    drive = ride([0, 40, 0, 40], 10)
    assert play(model, drive) == pytest.approx(drive / 8.0, abs=1e-13)


def test_past_the_last_break_point_the_last_slope_goes_on():
    model = Model((Maxwell.of(table(K)),))
    y = play(model, np.array([0.0, 100.0, 101.0, 102.0]))
    assert np.diff(y)[1:] == pytest.approx(1.0 / K[-1], rel=1e-12)


def test_a_gap_in_the_drive_is_named():
    model = Model((Maxwell.of(table(K)),))
    drive = ride([0, 12, 0], 50)
    drive[31] = np.nan
    with pytest.raises(InputError, match="sample 31") as e:
        play(model, drive)
    assert e.value.code == "not-a-number"


def test_unequal_lengths_are_refused():
    with pytest.raises(InputError):
        Model((Maxwell.of(table(K)),)).simulate(np.zeros(3), np.zeros(4))


def test_a_law_that_stops_the_actuator_is_refused_with_the_half_loop():
    model = lawful("range")
    model = model.with_stage(CAUSES["range-dependence"].of(slope=-1.0, offset=0.0))
    with pytest.raises(InputError, match="first slope of half loop") as e:
        play(model, ride([0, 12, 0, 12], 20))
    assert e.value.code == "slope-not-positive"


def test_a_history_that_is_known_removes_the_first_rise():
    model = lawful("range")
    drive = ride([0.0, 10.0, 0.0, 10.0], 40)
    later = model.simulate(np.arange(drive.size) / 1e4, drive, history="unknown")
    assert later[40] == pytest.approx(later[120], abs=1e-12)
    virgin = play(model, drive)
    assert abs(virgin[40] - virgin[80] - (virgin[120] - virgin[80])) < 1e-12
    assert abs(virgin[80]) > 0.01
    assert abs(later[80]) < 1e-12


@pytest.mark.parametrize("name", ["initiation", "range", "extremum", "direction"])
@pytest.mark.parametrize("noise", [0.003, 0.05, 0.6])
def test_small_loops_are_walked_as_large_ones(name, noise):
    # a drive whose every sample is held is the same drive, but none of its loops is short
    rng = np.random.default_rng(int(1e3 * noise))
    drive = ride([0, 14, 2, 9, -7, 14, -3, 15], 150)
    drive = drive + noise * rng.standard_normal(drive.size)
    held = np.repeat(drive, 30)
    branches = lawful(name).branches()
    results = []
    for v in (drive, held):
        walked = branches.walk(v, half_loops(v, 8.0 * noise))
        assert np.array_equal(walked.ints[1:, 0], walked.ints[:-1, 1])
        results.append(branches.displacement(v, walked))
    assert results[1][::30] == pytest.approx(results[0], abs=2e-12)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("finer", [(0.5,), (0.3, 0.8), (1.5,), ()])
def test_a_law_with_a_reach_of_its_own_does_not_care_where_the_table_breaks(name, finer):
    """Elements without a spring move no slope; the law reaches over them."""
    coarse = lawful(name)
    table = coarse.maxwell.elements
    slides = np.sort(np.concatenate([table.slides_at_um, [s * DX for s in finer]]))
    springs = np.zeros(slides.size)
    springs[np.isin(slides, table.slides_at_um)] = table.k_v_per_um
    stages = []
    for stage in coarse.stages:
        if isinstance(stage, Maxwell):
            stage = Maxwell.of(Elements(springs, slides))
        elif stage.id != "initiation-stage":
            values = {n: stage[n] for n in stage.parameters}
            stage = type(stage).of(None, **values, reach=2.0 * DX)
        stages.append(stage)
    drive = ride([0, 12, 0, 12, 0, 5, 3, 5, 0, 14, 13.9, 14, 1], 31)
    assert play(Model(tuple(stages)), drive) == pytest.approx(play(coarse, drive), abs=1e-12)
