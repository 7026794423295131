"""Recordings of unknown history that begin at rest, with a memory or with none."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.early import remembered
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification import prepare
from piezo_rig.run_file.sweep import Sweep
from tests.diagnosis.sliders import play
from tests.more import first_of

RATE, NOISE_UM = 1000.0, 2e-3
LIMITS = np.linspace(0.5, 36.0, 72)


def moved_by(volts: np.ndarray, stiffer: float) -> np.ndarray:
    """From rest; the first rise gives way less by a share of the spring."""
    furthest = np.maximum.accumulate(np.abs(volts - volts[0]))
    return play(volts, LIMITS, 0.0007) - stiffer * 0.08 * furthest


def recording(number: int, volts: np.ndarray, moved: np.ndarray) -> Sweep:
    noise = NOISE_UM * np.random.default_rng(number).standard_normal(volts.size)
    return Sweep(f"sweep_{number:04d}", volts, moved + noise, RATE, 1.0, 0.0, 1.0, 1, 0.0, "", 1,
                 "unknown", 100.0 * number, "IMPORTED")  # fmt: skip


def walk(seed: int) -> np.ndarray:
    """A smooth walk that begins at 0 V and comes to 70 V somewhere."""
    rng, time = np.random.default_rng(seed), np.arange(8000) / RATE
    v = sum(
        rng.normal() / f * (np.sin(2 * np.pi * f * time + phase) - np.sin(phase))
        for f, phase in zip((0.3, 0.7, 1.3, 2.2, 3.1), rng.uniform(0, 6.28, 5), strict=True)
    )
    v = np.abs(v)
    return 70.0 * v / v.max()


def triangle(number: int) -> np.ndarray:
    saw = np.abs(2.0 * ((0.75 * np.arange(4500) / RATE) % 1.0) - 1.0)
    return (1.0 - saw) * (80.0 - 10.0 * number)


def ridden(drive, excursion_v: float = 0.0, stiffer: float = 0.0) -> list[Sweep]:
    """Two drives after an excursion that nobody recorded."""
    out = []
    for number in (1, 2):
        volts, up = drive(number), np.linspace(0.0, excursion_v, 200)
        whole = np.concatenate([up, up[::-1], volts]) if excursion_v else volts
        moved = moved_by(whole, stiffer)[-volts.size :]
        out.append(recording(number, volts, moved - moved[0]))
    return out


def rises(sweeps: list[Sweep]) -> tuple[list[bool], list[bool]]:
    """Which are taken for a first rise by what they leave behind, and which still are then."""
    data = prepare(sweeps, first_rises=True, clipped=True)
    point = Point(starting_model(group_tracks(data, sweeps), (), "classical"))
    left = remembered.without_remembered(data, sweeps, point)
    return [t.virgin for t in data.tracks], [t.virgin for t in left.tracks]


@pytest.mark.study
@pytest.mark.parametrize("excursion_v", [67.0, 68.0])
def test_a_memory_of_nearly_all_that_follows_is_no_first_rise(excursion_v):
    sweeps = ridden(walk, excursion_v)
    before, after = rises(sweeps)
    assert any(before)
    assert not any(after)
    said = [n for n in diagnose(sweeps).notes if "as after an earlier excursion" in n]
    assert len(said) == sum(before)


@pytest.mark.parametrize("drive", [walk, triangle])
@pytest.mark.parametrize("excursion_v", [25.0, 45.0, 60.0])
def test_a_memory_of_part_of_what_follows_is_no_first_rise(drive, excursion_v):
    before, after = rises(ridden(drive, excursion_v))
    assert any(before)
    assert not any(after)


@pytest.mark.parametrize("drive", [walk, triangle])
@pytest.mark.parametrize("stiffer", first_of(3, [-0.2, 0.0, 0.1, -0.05, 0.05, 0.3]))
def test_a_first_rise_is_no_memory(drive, stiffer):
    before, after = rises(ridden(drive, stiffer=stiffer))
    assert before == after == [True, True]


@pytest.mark.study
def test_an_initiation_curve_of_unknown_history_is_still_found():
    found = diagnose(ridden(triangle, stiffer=0.1))
    assert [f.cause for f in found.findings] == ["initiation-stage"]


def sitting(stiffer: float = 0.0, drives: tuple[np.ndarray, ...] = ()) -> list[Sweep]:
    """Drives in turn, twice, without a rest between: only the first recording begins virgin."""
    drives = (drives or (triangle(1), 5.0 + 0.8 * triangle(2))) * 2
    joined, begin = list[np.ndarray](), 0.0
    for volts in drives:  # a ramp between them that nobody records
        joined += [np.linspace(begin, volts[0], 50), volts]
        begin = volts[-1]
    whole = moved_by(np.concatenate(joined), stiffer)
    out, at = [], 0
    for number, volts in enumerate(drives, 1):
        at += 50 + volts.size
        moved = whole[at - volts.size : at]
        out.append(recording(number, volts, moved - moved[0]))
    return out


@pytest.mark.parametrize("stiffer", first_of(1, [0.1, 0.0]))
def test_a_first_rise_is_no_repeat_of_one_that_remembers(stiffer):
    sweeps = sitting(stiffer)
    before, after = rises(sweeps)
    assert before[0]
    assert not any(after)
    found = diagnose(sweeps)
    assert found.findings == []
    assert not found.unexplained.detected
    assert found.noise_floor_nm == pytest.approx(2.0, rel=0.1)
    assert any("a repeat of it begins otherwise" in n for n in found.notes)


def test_a_first_rise_is_no_repeat_of_one_that_only_seems_to_begin_at_rest():
    """As after larger drives, whose creep still goes on while it begins."""
    sweeps = sitting(0.0, (0.2 * triangle(1), triangle(2), 0.9 * triangle(1), triangle(3)))
    goes_on = 0.03 * np.exp(-np.arange(triangle(1).size) / RATE / 0.5)
    late = sweeps[4]
    sweeps[4] = late.with_(sensor_v=late.displacement_um + goes_on[: late.displacement_um.size])
    before, after = rises(sweeps)
    assert before[0]
    assert before[4]
    assert not any(after)


def test_what_settles_at_the_beginning_of_a_sitting_is_no_first_rise():
    """After a larger drive all loops that grow come back to where they begin; a zero that settles
    leaves as much behind in the first recording as a virgin one would, and not in its repeat.
    """
    time = np.arange(4000) / RATE
    grows = 36.0 * time / time[-1] * (1.0 - np.abs(2.0 * ((2.0 * time) % 1.0) - 1.0))
    before = np.concatenate([np.linspace(0.0, 75.0, 200), np.linspace(75.0, 0.0, 200)])
    sweeps = sitting(0.0, (before, grows, triangle(1)))[1:3]
    sweeps += [s.with_(name=f"sweep_{4 + k:04d}", start_time=s.start_time + 300.0)
               for k, s in enumerate(sweeps)]  # fmt: skip
    first = sweeps[0]
    settles = -0.02 * np.exp(-time / 1.0)
    sweeps[0] = first.with_(sensor_v=first.displacement_um + settles)
    again = 3.0 * np.random.default_rng(9).standard_normal(time.size) * 1e-3
    sweeps[2] = sweeps[2].with_(sensor_v=sweeps[2].displacement_um + again)
    before, after = rises(sweeps)
    assert before[0]
    assert not any(after)


def test_what_comes_after_a_recording_that_remembers_remembers_as_well():
    """Whatever else is amiss in it: warmth that fades here."""
    sweeps = ridden(triangle, 45.0)
    time = np.arange(sweeps[1].samples) / RATE
    warm = 0.15 * np.exp(-time / 0.4)
    alone = sweeps[1].with_(sensor_v=sweeps[1].displacement_um + warm)
    begun = [replace(s, start_time=t) for s, t in zip([sweeps[0], alone], (5.0, 30.0), strict=True)]
    assert rises(begun)[1] == [False, False]
    earlier = [replace(s, start_time=t) for s, t in zip(begun, (30.0, 5.0), strict=True)]
    assert rises(earlier)[1] == [False, True]


def test_damage_to_a_first_rise_does_not_make_it_another():
    volts = triangle(1)
    moved = moved_by(volts, 0.0)
    torn = moved + np.where(np.arange(volts.size) < 300, 0.0, 0.3164)
    again, third = recording(3, volts, moved), recording(4, triangle(2), moved_by(triangle(2), 0.0))
    _, after = rises([recording(1, volts, torn), again, third])
    assert all(after)


def test_what_is_said_to_be_virgin_is_taken_at_its_word():
    sweeps = [s.with_(history="virgin") for s in ridden(walk, 68.0)]
    assert rises(sweeps) == ([True, True], [True, True])


@pytest.mark.parametrize("number", [1, 2])
def test_a_memory_of_all_is_none_although_what_follows_does_not_fit(number):
    """Lost samples spoil the baseline; the beginning is that of later rises all the same."""
    sweeps = ridden(walk, 70.0)
    for k, sweep in enumerate(sweeps):
        moved = np.delete(sweep.displacement_um, slice(5500, 5500 + 4 * number))
        moved = np.append(moved, np.full(4 * number, moved[-1]))
        sweeps[k] = sweep.with_(sensor_v=moved)
    before, after = rises(sweeps)
    assert any(before)
    assert not any(after)


@pytest.mark.parametrize("place", [0, 3])
def test_only_the_first_of_a_session_begins_at_rest_where_the_others_do_not(place):
    """As a later one may seem to, whose drive lags and never comes back to where it began."""
    sweeps = [s for k in range(4) for s in ridden(triangle, 80.0)[:1]]
    volts = triangle(2)
    sweeps.insert(place, recording(9, volts, moved_by(volts, 0.0)))
    sweeps = [
        replace(s, name=f"sweep_{k + 1:04d}", start_time=20.0 * k) for k, s in enumerate(sweeps)
    ]
    before, after = rises(sweeps)
    assert before == [k == place for k in range(5)]
    assert after == [k == place == 0 for k in range(5)]


def begun_after(excursions_v: tuple[float, ...]) -> list[Sweep]:
    """One drive again and again, after excursions that differ, each before one of them."""
    out, start = [], 0.0
    volts = np.concatenate([np.zeros(100), triangle(0)[2000:][::-1], triangle(0)])
    for repeat, excursion_v in enumerate(excursions_v, 1):
        up = np.linspace(0.0, excursion_v, 300)
        moved = moved_by(np.concatenate([up, up[::-1], volts]), 0.0)[-volts.size :]
        noise = NOISE_UM * np.random.default_rng(repeat).standard_normal(volts.size)
        out.append(Sweep(
            f"sweep_{repeat:04d}", volts, moved - moved[0] + noise, RATE, 1.0, 0.0, 1.0, 1, 0.0,
            "0-80", repeat, "unknown", start, "IMPORTED",
        ))  # fmt: skip
        start += 30.0
    return out


@pytest.mark.study
@pytest.mark.parametrize("excursions_v", [(72.0, 80.0), (60.0, 80.0), (20.0, 80.0, 80.0)])
def test_repeats_that_begin_with_another_memory_have_neither_jumped_nor_lost_anything(
    excursions_v,
):
    """They part slowly, by some multiple of 79.1 nm or of a sample's way, and stay apart."""
    found = diagnose(begun_after(excursions_v))
    assert found.findings == []
    assert not found.unexplained.detected


@pytest.fixture
def stepped():
    """Steps between levels, in edges of 4 ms, played twice after different excursions."""
    levels = 70.0 * np.random.default_rng(4).random(40)
    levels[:5] = 0.0, 70.0, 0.0, 70.0, 0.0
    volts = np.concatenate([
        np.concatenate([np.linspace(a, b, 5)[1:], np.full(46, b)])
        for a, b in pairwise(levels)
    ])  # fmt: skip
    volts = np.append(0.0, volts)
    out = []
    for number, excursion_v in ((1, 20.0), (2, 45.0)):
        up = np.linspace(0.0, excursion_v, 200)
        moved = moved_by(np.concatenate([up, up[::-1], volts]), 0.0)[-volts.size :]
        out.append(recording(number, volts, moved - moved[0]))
    return out


def test_two_that_seem_to_begin_at_rest_otherwise_than_each_other_both_remember(stepped):
    before, after = rises(stepped)
    assert all(before)
    assert not any(after)


def test_edges_of_a_drive_that_finds_other_memories_are_no_jumps(stepped):
    out = diagnose(stepped)
    assert out.findings == []
    assert not out.unexplained.detected
    assert out.noise_floor_nm == pytest.approx(1e3 * NOISE_UM, rel=0.1)


def test_a_difference_of_memories_that_is_a_step_of_the_scale_by_chance_is_no_jump():
    levels = 70.0 * np.random.default_rng(5).random(40)
    levels[:4] = 30.0, 55.0, 70.0, 0.0
    parts = [np.full(40, 30.0)]
    for a, b in pairwise(levels):
        parts += [np.linspace(a, b, 5)[1:], np.full(46, b)]
    volts = np.concatenate(parts)
    moved = play(volts, LIMITS, 0.0007)
    step = 0.0791 * np.clip((volts - 30.0) / 25.0, 0.0, 1.0)  # lambda/8, within the first edge
    step[44:] = 0.0791
    out = diagnose([recording(1, volts, moved), recording(2, volts, moved + step)])
    assert out.findings == []

