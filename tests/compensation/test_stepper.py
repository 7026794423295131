"""A model sample by sample is the model, and inverted it gives the drive back."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from piezo_rig.causes.creep import FAST, SHARES
from piezo_rig.chain import Elements, Maxwell, Model
from piezo_rig.compensation import Bounds, OutOfReach, Stepper
from piezo_rig.errors import InputError

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "chain"))

from inverted_models import EVERY, legs, model_with
from reference_actuators import Sliders

ANYWHERE = Bounds(-200.0, 200.0, 1e9)
K, X = [4.0, 3.0, 2.0, 5.0], [0.2, 0.6, 1.5, 9.0]
levels = st.floats(0.0, 60.0).map(lambda v: round(v, 1))


def stepped(model, time, drive):
    stepper = Stepper(model)
    stepper.begin(time[0], drive[0])
    return np.append(0.0, stepper.play(time[1:], drive[1:]))


def followed(model, time, target, first=0.0):
    stepper = Stepper(model)
    stepper.begin(time[0], first)
    return np.append(first, stepper.follow(time[1:], target[1:], ANYWHERE))


@settings(max_examples=60)
@given(
    ids=st.sets(st.sampled_from(EVERY)),
    form=st.sampled_from([{"widens": 0.0}, {"widens": 1.0}, {"widens": 2.0, "opens_um": 0.9},
                          {"settles": 1.0}, {"levels_off": 1.0}]),
    along=st.sampled_from([{}, {"moves_along": 1.0}]),
    exponent=st.sampled_from([0.5, 1.0]), first=st.sampled_from([0.0, 20.0]),
    reach=st.sampled_from([
        {}, {"reach": 0.3, "ties": 0.0}, {"reach": 0.3, "ties": 1.0},
        {"reach": 0.3, "carries": 1.0}, {"reach": 0.3, "taper": 1.0, "carries": 1.0, "ties": 1.0},
    ]),
    shares=st.sampled_from([{}, {n: 0.2 * k for k, n in enumerate(SHARES)},
                            {n: 0.1 * k for k, n in enumerate(FAST + SHARES)}]),
    closes=st.sampled_from([
        {}, {"closing": 1.0}, {"closing": 1.0, "taper": 1.0},
        {"closing": 1.0, "taper": 2.0, "from_below": 1.0}, {"closing": 1.0, "taper": 4.0},
        {"closing": 1.0, "taper": 5.0},
    ]),
    turns=st.lists(levels, min_size=2, max_size=25), points=st.integers(3, 40),
)
def test_sample_by_sample_is_the_whole_signal(
    ids, form, along, exponent, first, reach, shares, closes, turns, points
):
    rate = {**form, "exponent": exponent}
    own = {"rate-dependence": rate, "range-dependence": reach, "creep": shares,
           "direction-asymmetry": closes, "resonance": along}  # fmt: skip
    model = model_with(*(id for id in EVERY if id in ids), **own)
    time, drive = legs([first, *turns], points)
    expected = model.simulate(time, drive, free_end=True)
    np.testing.assert_allclose(stepped(model, time, drive), expected, rtol=0, atol=1e-9)


def test_nested_and_closing_loops_and_uneven_samples():
    model = model_with("initiation-stage", "range-dependence", "direction-asymmetry", "creep",
                       "resonance", "amplifier-lag")
    swing = 35.0 + 30.0 * np.cos(np.pi * np.arange(1, 60)) * 0.95 ** np.arange(59)
    _, drive = legs([0.0, *swing, *swing[::-1], 0.0], 25)
    time = np.cumsum(np.random.default_rng(2).uniform(1e-4, 1e-3, drive.size))
    expected = model.simulate(time, drive, free_end=True)
    np.testing.assert_allclose(stepped(model, time, drive), expected, rtol=0, atol=1e-9)


def test_a_signal_may_come_in_pieces():
    model = model_with("initiation-stage", "range-dependence", "creep", "resonance")
    time, drive = legs([0.0, 50.0, 10.0, 40.0, 20.0, 60.0], 50)
    stepper = Stepper(model)
    stepper.begin(time[0], drive[0])
    pieces = [stepper.play(time[a:b], drive[a:b]) for a, b in ((1, 2), (2, 90), (90, 251))]
    np.testing.assert_array_equal(np.concatenate(pieces), stepped(model, time, drive)[1:])
    with pytest.raises(InputError) as late:
        stepper.play(time[:2], drive[:2])
    assert late.value.code == "time-order"


def test_the_drive_of_textbook_sliders_is_found_from_their_displacement():
    model = Model((Maxwell.of(Elements(np.array(K), np.array(X))),))
    rng = np.random.default_rng(4)
    time, drive = legs([0.0, 12.0, 3.0, 9.0, 5.0, 8.0, *rng.uniform(0, 20, 20)], 30)
    target = np.array(Sliders(K, X).play(drive))
    np.testing.assert_allclose(followed(model, time, target), drive, rtol=0, atol=1e-9)


@settings(max_examples=25)
@given(
    ids=st.sets(st.sampled_from([id for id in EVERY if id != "drive-clipping"])),
    settles=st.sampled_from([0.0, 1.0]),
    closes=st.sampled_from([
        {}, {"closing": 1.0}, {"closing": 1.0, "taper": 1.0},
        {"closing": 1.0, "taper": 2.0, "from_below": 1.0}, {"closing": 1.0, "taper": 3.0},
    ]),
    turns=st.lists(levels, min_size=2, max_size=15), points=st.integers(3, 30),
)
def test_an_inverted_model_follows_what_it_can_do(ids, settles, closes, turns, points):
    # within what a drive outruns; the rest is bounded, see below
    rate = {"lag_um": 0.005, "settles": settles}
    own = {"rate-dependence": rate, "direction-asymmetry": closes}
    model = model_with(*(id for id in EVERY if id in ids), **own)
    time, drive = legs([0.0, *turns], points)
    target = model.simulate(time, drive, free_end=True)
    found = followed(model, time, target)
    again = model.simulate(time, found, free_end=True)
    np.testing.assert_allclose(again, target, rtol=0, atol=1e-8)


@pytest.mark.parametrize("ids", [
    ("input-bend",), ("output-bend",), ("bend", "input-bend", "output-bend", "creep"),
    ("drive-gain", "input-bend", "extremum-dependence", "output-bend", "resonance"),
])  # fmt: skip
def test_bends_of_the_body_are_played_and_inverted(ids):
    model = model_with(*ids)
    rng = np.random.default_rng(5)
    time, drive = legs([0.0, *rng.uniform(0.0, 75.0, 20)], 60)
    target = model.simulate(time, drive, free_end=True)
    np.testing.assert_allclose(stepped(model, time, drive), target, rtol=0, atol=1e-9)
    again = model.simulate(time, followed(model, time, target), free_end=True)
    np.testing.assert_allclose(again, target, rtol=0, atol=1e-8)


def test_nothing_of_a_target_is_known_before_its_sample():
    model = model_with(*EVERY)
    time, drive = legs([0.0, 50.0, 20.0, 40.0, 30.0], 100)
    target = model.simulate(time, drive, free_end=True)
    whole = followed(model, time, target)
    other = np.where(np.arange(target.size) < 250, target, target[249])
    np.testing.assert_array_equal(followed(model, time, other)[:250], whole[:250])


def test_more_turning_points_than_there_was_room_for():
    model = model_with("initiation-stage", "range-dependence")
    swing = 35.0 + 34.0 * np.cos(np.pi * np.arange(1, 400)) * np.linspace(1.0, 0.1, 399)
    time, drive = legs([0.0, *swing], 3)
    expected = model.simulate(time, drive, free_end=True)
    np.testing.assert_allclose(stepped(model, time, drive), expected, rtol=0, atol=1e-9)


def test_a_law_that_ends_in_a_negative_slope_is_refused():
    model = model_with("range-dependence", **{"range-dependence": {"slope": -0.4, "offset": 0.0}})
    time, drive = legs([0.0, 60.0, 10.0], 20)
    with pytest.raises(InputError) as bad:
        stepped(model, time, drive)
    assert bad.value.code == "slope-not-positive"


def test_what_is_in_reach_is_said():
    spring = Model((Maxwell.of(Elements(np.array([10.0]), np.array([1.0]))),))
    stepper = Stepper(spring)
    stepper.begin(0.0, 0.0)
    with pytest.raises(OutOfReach) as out:
        stepper.follow(np.array([0.1, 0.2]), np.array([1.0, 3.0]), Bounds(0.0, 25.0, 1e9))
    assert (out.value.sample, out.value.drive_v) == (1, pytest.approx(10.0))
    assert (out.value.least_um, out.value.most_um) == pytest.approx((0.0, 2.5))
