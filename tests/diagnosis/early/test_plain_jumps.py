"""Jumps while the actuator stands, which a base that was fitted to them has followed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from piezo_rig.causes import named_model
from piezo_rig.diagnosis.early.breaks import find_breaks
from piezo_rig.diagnosis.early.peaks import search_of
from piezo_rig.diagnosis.early.plain_jumps import jumps_at_sight
from piezo_rig.diagnosis.early.traces import stretches
from piezo_rig.diagnosis.engine import plainly
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification import prepare
from tests.diagnosis.sliders import play, recorded

RATE, HOLD_S = 2000.0, 0.6
LEVELS = (20.0, 40.0, 60.0, 75.0, 55.0, 30.0, 10.0, 45.0)
STEP_UM = 0.0791


def staircase(ramp_v_per_s=400.0):
    """Minor loops, then holds of several levels; volts."""
    loops = np.concatenate([
        np.linspace(0.0, 60.0, 400), np.linspace(60.0, 15.0, 300), np.linspace(15.0, 75.0, 400),
        np.linspace(75.0, 0.0, 500),
    ])  # fmt: skip
    parts, now = [loops], 0.0
    for level in LEVELS:
        steps = max(round(abs(level - now) / ramp_v_per_s * RATE), 1)
        parts += [np.linspace(now, level, steps), np.full(round(HOLD_S * RATE), level)]
        now = level
    return np.concatenate(parts)


DRIVE = staircase()
MOVED = play(DRIVE, np.linspace(0.5, 36.0, 72), 0.003)
HOLDS = 1600 + np.cumsum([
    max(round(abs(b - a) / 400.0 * RATE), 1) + round(HOLD_S * RATE)
    for a, b in zip((0.0, *LEVELS[:-1]), LEVELS, strict=True)
])  # fmt: skip


def pink(n, seed, nm=2.0):
    size = 1 << int(np.ceil(np.log2(4 * n)))
    f = np.maximum(np.arange(size // 2 + 1), 1) / size
    x = np.fft.irfft(np.fft.rfft(np.random.default_rng(seed).standard_normal(size)) / f**0.5, size)
    return 1e-3 * nm * x[:n] / x[:n].std()


def searched(seen, known=None):
    """What is there to be searched, beside a base that was fitted to it, or ``known`` (n,)."""
    sweeps = [recorded(DRIVE, seen, RATE)]
    groups = group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)
    point = Point(starting_model(groups, named_model("classical"), "classical"))
    model = plainly(groups, point).point.model
    predicted = [g.predicted(model) if known is None else known for g in groups.groups]
    return groups, model, sweeps, predicted


@pytest.mark.parametrize("seed", [
    2, pytest.param(1, marks=pytest.mark.study), pytest.param(3, marks=pytest.mark.study),
])  # fmt: skip
def test_two_jumps_in_a_hold_that_the_base_has_followed_are_found_to_the_sample(seed):
    at = int(HOLDS[5] - 900), int(HOLDS[5] - 500)
    own = sum(STEP_UM * (np.arange(DRIVE.size) >= k) for k in at)
    groups, model, sweeps, _ = searched(MOVED + own + pink(DRIVE.size, seed))
    breaks = find_breaks(groups, model, sweeps, 1e-4).breaks
    assert [(b.cause, b.index, b.count) for b in breaks] == [
        ("fringe-jump", k, 1) for k in at
    ]


@given(
    hold=st.integers(0, len(LEVELS) - 1), place=st.integers(300, 1000), seed=st.integers(0, 10**6),
    share=st.floats(-2.4, 2.4).filter(lambda s: abs(s - round(s)) > 0.15),
)  # fmt: skip
@settings(max_examples=12)
def test_a_step_of_no_whole_number_is_no_jump_at_sight(hold, place, seed, share):
    own = share * STEP_UM * (np.arange(DRIVE.size) >= HOLDS[hold] - place)
    seen = MOVED + own + pink(DRIVE.size, seed)
    groups, _, sweeps, predicted = searched(seen, known=MOVED)
    search = search_of(groups, predicted, stretches(groups, predicted, sweeps, None), [], sweeps)
    assert jumps_at_sight(search) == []


@given(
    hold=st.integers(0, len(LEVELS) - 1), place=st.integers(300, 1000), seed=st.integers(0, 10**6),
    count=st.sampled_from([-3, -2, -1, 1, 2, 3]),
)  # fmt: skip
@settings(max_examples=12)
def test_a_whole_number_is_one_of_so_many_steps(hold, place, seed, count):
    at = int(HOLDS[hold] - place)
    seen = MOVED + count * STEP_UM * (np.arange(DRIVE.size) >= at) + pink(DRIVE.size, seed)
    groups, _, sweeps, predicted = searched(seen, known=MOVED)
    search = search_of(groups, predicted, stretches(groups, predicted, sweeps, None), [], sweeps)
    assert [(b.index, b.count) for b in jumps_at_sight(search)] == [(at, count)]


def test_steps_of_the_drive_that_a_model_is_wrong_about_are_none():
    """Here by exactly as much as a jump, within the millisecond that the drive takes."""
    edge = HOLDS[3] - round(HOLD_S * RATE) - 2
    own = STEP_UM * (np.arange(DRIVE.size) >= edge)
    groups, _, sweeps, predicted = searched(MOVED + own + pink(DRIVE.size, 5), known=MOVED)
    search = search_of(groups, predicted, stretches(groups, predicted, sweeps, None), [], sweeps)
    assert jumps_at_sight(search) == []
