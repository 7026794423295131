"""Samples lost while a drive holds: shown by the next ramp, in whichever recordings they are."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from piezo_rig.diagnosis.early import holds
from piezo_rig.diagnosis.early.breaks import find_breaks
from piezo_rig.diagnosis.early.holds import losses_between_holds, ramps_of
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification import prepare
from piezo_rig.run_file import Sweep
from tests.diagnosis.early.test_breaks_and_losses import LEVEL, MODEL
from tests.more import first_of

RATE = 1000.0
LEVELS = [0.0, 42.0, 19.0, 55.0, 24.0, 60.0, 0.0]
RAMP, HOLD = 150, 400  # samples
STEP = RAMP + HOLD
HOLDS = [(k * STEP - HOLD, k * STEP) for k in range(1, len(LEVELS) - 1)]


def steps(levels=LEVELS, ramp=RAMP, hold=HOLD):
    drive = []
    for a, b in pairwise(levels):
        drive += [np.linspace(a, b, ramp + 1)[:-1], np.full(hold, b)]
    return np.concatenate(drive)


def record(drive, losses, seed, kind="white", rms=2e-3):
    """What is left of 0.12 um/V of a drive; it stays where it ends. ``losses`` : (sample, count)"""
    rng = np.random.default_rng(seed)
    long = np.append(drive, np.full(400, drive[-1]))
    noise = rng.standard_normal(long.size)
    if kind == "ar":
        noise = np.sqrt(1.0 - 0.9**2) * lfilter([1.0], [1.0, -0.9], noise)
    kept = np.ones(long.size, bool)
    for at, count in losses:
        kept[at : at + count] = False
    return (0.12 * long + rms * noise)[kept][: drive.size]


def sweeps_of(drive, each, kind="white", seed=0, name="steps"):
    """One recording for every list of losses."""
    return [
        Sweep(f"{name} {r + 1}", drive, record(drive, losses, 10 * seed + r, kind), RATE, 1.0, 0.0,
              1.0, 1, 0.0, name, r + 1, "virgin", 60.0 * (r + seed), "IMPORTED")
        for r, losses in enumerate(each)
    ]  # fmt: skip


def found_in(drive, each, kind="white", seed=0):
    sweeps = sweeps_of(drive, each, kind, seed)
    groups = group_tracks(prepare(sweeps, first_rises=True), sweeps)
    return losses_between_holds(groups.groups[0], 0, 0.12 * drive, sweeps)


def places(losses):
    """(recording, number of the hold or sample in a ramp, samples) of losses as they happened."""
    out = {}
    for row, each in enumerate(losses):
        before = 0
        for at, count in sorted(each):
            hold = next((f"hold {k}" for k, (a, b) in enumerate(HOLDS) if a <= at < b), at - before)
            out[row, hold] = out.get((row, hold), 0) + count
            before += count
    return sorted((row, hold, n) for (row, hold), n in out.items())


def placed(breaks):
    """The same of what was found; a hold begins earlier in a recording that has lost samples."""
    out = []
    for b in breaks:
        before = sum(x.count for x in breaks if x.row == b.row and x.index < b.index)
        at = b.index + before
        hold = next((f"hold {k}" for k, (a, c) in enumerate(HOLDS) if a < at < c), b.index)
        out.append((b.row, hold, b.count))
    return sorted(out, key=str)


@pytest.mark.parametrize("kind", ["white", "ar"])
@pytest.mark.parametrize("losses", [
    [[], [(HOLDS[0][0] + 100, 1)]],
    [[(HOLDS[1][0] + 30, 1)], []],
    [[(HOLDS[0][0] + 50, 1), (HOLDS[2][0] + 50, 1)], [(HOLDS[1][0] + 90, 1)]],  # level in between
    [[(HOLDS[2][0] + 50, 1)], [(HOLDS[2][0] + 60, 3)]],
    [[(HOLDS[0][0] + 9, 1), (HOLDS[3][0] + 9, 1)], [(HOLDS[1][0] + 9, 1), (HOLDS[2][0] + 9, 2)]],
    [[], [(HOLDS[1][0] + 100, 30)]],
    [[(HOLDS[0][0] + 100, 1)], [(HOLDS[1][0] + 100, 2)], [(HOLDS[2][0] + 100, 1)]],
    [[], [], [(HOLDS[3][0] + 100, 4)]],
])  # fmt: skip
def test_losses_in_holds_are_counted_in_the_recordings_that_have_them(losses, kind):
    assert placed(found_in(steps(), losses, kind)) == places(losses)


@pytest.mark.parametrize("kind", ["white", "ar"])
@pytest.mark.parametrize("at", first_of(1, [2 * STEP + 40, 3 * STEP + 110, 80]))
def test_a_loss_in_a_ramp_is_placed_in_it(at, kind):
    losses = [[], [(HOLDS[0][0] + 100, 1), (at, 1)]]
    (hold, ramp) = sorted(found_in(steps(), losses, kind), key=lambda b: abs(b.index - at))[::-1]
    assert (hold.row, hold.count, ramp.row, ramp.count) == (1, 1, 1, 1)
    lost = at - (HOLDS[0][0] + 100 < at)
    assert ramp.low - 2 <= lost <= ramp.high + 2
    assert abs(ramp.index - lost) < 8


@pytest.mark.parametrize("kind", ["white", "ar"])
@pytest.mark.parametrize("recordings", [1, 2, 3])
@pytest.mark.parametrize("seed", first_of(1, range(8)))
def test_recordings_that_have_lost_nothing_show_none(recordings, kind, seed):
    assert found_in(steps(), [[]] * recordings, kind, seed) == []


def test_a_drive_that_never_holds_is_left_to_others():
    drive = np.abs(np.arange(-1000, 1000) % 500 - 250) * 0.2
    assert ramps_of(0.12 * drive) != []
    assert found_in(drive - drive[0], [[], [(700, 1)]]) == []


def test_ramps_that_are_too_long_to_be_laid_over_each_other_are_left_to_others(monkeypatch):
    """Every way in which some may be lost is held at a time: 90 of them for two recordings."""
    losses = [[], [(HOLDS[0][0] + 100, 1)]]
    longest = RAMP + 2 * 60 + 40 + 1  # samples, with those of the holds beside it
    monkeypatch.setattr(holds, "LONG", 100 * longest)
    assert placed(found_in(steps(), losses)) == places(losses)
    monkeypatch.setattr(holds, "LONG", 80 * RAMP)
    assert found_in(steps(), losses) == []


@pytest.mark.parametrize("off_um", [0.05, 0.0791])
def test_recordings_that_differ_otherwise_are_left_to_others(off_um):
    """One that jumps in a ramp, and stays there, is ahead by no number of samples."""
    sweeps = sweeps_of(steps(), [[], []])
    volts = sweeps[1].sensor_v.copy()
    volts[2 * STEP + 75 :] += off_um
    sweeps[1] = sweeps[1].with_(sensor_v=volts)
    groups = group_tracks(prepare(sweeps, first_rises=True), sweeps)
    assert losses_between_holds(groups.groups[0], 0, 0.12 * steps(), sweeps) == []


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.lists(
    st.tuples(st.integers(0, 1), st.integers(0, len(HOLDS) - 1), st.integers(1, 3)),
    max_size=4, unique_by=lambda loss: loss[1],
))  # fmt: skip
def test_any_few_losses_in_holds_are_found(losses):
    each = [[], []]
    for row, hold, count in losses:
        each[row].append((HOLDS[hold][0] + 60 + 40 * row, count))
    assert placed(found_in(steps(), each)) == places(each)


def test_the_search_finds_what_both_recordings_of_a_drive_have_lost_in_holds():
    """One by one none of them lasts, so that whole stretches look like jumps, or like a clock."""
    losses = [
        [(HOLDS[1][0] + 100, 1), (HOLDS[3][0] + 200, 1)],
        [(HOLDS[0][0] + 60, 1), (HOLDS[1][0] + 90, 1), (HOLDS[2][0] + 150, 1)],
    ]
    others = [0.0, 74.0, 15.0, 74.0, 20.0, 0.0]
    sweeps = sweeps_of(steps(), losses, "ar") + sweeps_of(
        steps(others), [[], []], "ar", 1, "others"
    )
    groups = group_tracks(prepare(sweeps, first_rises=True), sweeps)
    found = find_breaks(groups, MODEL, sweeps, LEVEL).breaks
    assert {b.cause for b in found} == {"dropped-samples"}
    assert {b.group for b in found} == {0}
    assert placed(found) == places(losses)
    assert all(b.p_value < LEVEL for b in found)
