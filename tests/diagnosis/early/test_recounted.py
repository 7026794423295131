"""Many samples lost in the only recording of a drive: a base that is fitted to what comes before
and to what comes after shows a share of them, and all of them are asked for.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.early import recounted
from piezo_rig.diagnosis.early.mended import DROP, Break
from tests.diagnosis.sliders import play, recorded

RATE, NOISE_UM = 5000.0, 2.5e-3


def ramps(seed: int, samples: int) -> np.ndarray:
    """Between random ends, each at a random speed of 150 to 300 V/s."""
    rng = np.random.default_rng(seed)
    parts, here = [np.zeros(1)], 0.0
    while sum(p.size for p in parts) < samples:
        there = rng.uniform(45.0, 75.0) if len(parts) % 2 else rng.uniform(0.0, 25.0)
        n = round(RATE * abs(there - here) / rng.uniform(150.0, 300.0))
        parts.append(np.linspace(here, there, n + 1)[1:])
        here = there
    return np.concatenate(parts)[:samples]


@pytest.mark.study
@pytest.mark.parametrize(("seed", "lost"), [(1, 23), (2, 31)])
def test_all_of_many_samples_that_were_lost_are_counted(seed, lost):
    samples, at = 36_000, 15_203
    drive = ramps(seed, samples + lost)
    moved = play(drive, np.linspace(0.5, 36.0, 72), 0.003)
    rng = np.random.default_rng(100 + seed)
    seen = np.delete(moved, np.s_[at : at + lost]) + NOISE_UM * rng.standard_normal(samples)
    found = diagnose([recorded(drive[:samples], seen, RATE)])
    assert [f.cause for f in found.findings] == ["dropped-samples"]
    (event,) = found.findings[0].events
    assert event.size == lost
    assert abs(event.index - at) <= 1
    assert not found.unexplained.detected


@pytest.mark.parametrize(("left", "enough", "count"), [
    (0.7, recounted.PLAINLY, 8),  # a base that lacks a drift leaves that much beside
    (0.7, recounted.BESIDE_ALL, 9),
    (0.95, recounted.BESIDE_ALL, 8),
    (0.3, recounted.PLAINLY, 9),
])  # fmt: skip
def test_beside_all_that_is_known_a_loss_is_counted_by_less(monkeypatch, left, enough, count):
    """Eight were counted; with nine so much of the squared error is left."""
    monkeypatch.setattr(recounted, "mended", lambda groups, predicted, kept: kept)
    monkeypatch.setattr(recounted, "square_of", lambda kept, point, members: (
        {8: 1.0, 9: left}.get(sum(b.count for b in kept), 5.0)
    ))  # fmt: skip
    alone = SimpleNamespace(repeats=1, predicted=lambda model: None)
    found = recounted.recounted(
        SimpleNamespace(groups=[alone]), SimpleNamespace(model=None),
        [Break(DROP, 0, 0, 500, 8, 500, 500, 900, 1e-9)], lambda groups, point: point, enough,
    )  # fmt: skip
    assert [b.count for b in found] == [count]


@pytest.mark.parametrize(("known", "found"), [((14,), [14, 4]), ((), [])])
def test_where_samples_were_lost_already_others_are_lost_for_less(monkeypatch, known, found):
    """A second loss leaves six tenths of what one leaves, and of what a clock leaves beside it."""
    left = {(): 1.0, (14,): 1.0, (14, 4): 0.6, (4,): 0.6}
    breaks = [Break(DROP, 0, 0, 500, n, 500, 500, 900, 1e-9) for n in known]
    more = Break(DROP, 0, 0, 700, 4, 700, 700, 900, 1e-9)

    def one_more(groups, point, have, *_):
        tried = None if more in have else [*have, more]
        return tried, (tried or have, point)

    monkeypatch.setattr(recounted, "mended", lambda groups, predicted, kept: kept)
    monkeypatch.setattr(recounted, "_one_more", one_more)
    monkeypatch.setattr(recounted, "recounted", lambda groups, point, breaks, *_: breaks)
    monkeypatch.setattr(recounted, "square_of", lambda kept, point, members: (
        left[tuple(b.count for b in kept)] if isinstance(kept, list) else 1.0
    ))  # fmt: skip
    alone = SimpleNamespace(repeats=1, predicted=lambda model: None)
    told = recounted.outright(
        SimpleNamespace(groups=[alone]), SimpleNamespace(model=None), [], breaks,
        lambda groups, point: point, 1.0,
    )  # fmt: skip
    assert [b.count for b in told] == found


@given(samples=st.integers(2, 900), most=st.integers(1, 60), seed=st.integers(0, 10**6))
@example(samples=2 * recounted.LEAST + 10, most=60, seed=0)
@settings(max_examples=60)
def test_a_recording_of_any_length_can_be_asked_for_its_plainest_loss(samples, most, seed):
    """Also one of just so many samples that no place for a loss is left between both ends."""
    new = plainest(samples, most, lost=0, seed=seed)
    assert new is None or recounted.LEAST <= new.index < samples - new.count - recounted.LEAST


@pytest.mark.parametrize("most", [4, 60])
def test_the_plainest_loss_is_where_it_is(most):
    new = plainest(1500, most, lost=4, seed=1)
    assert abs(new.index - 700) < 3
    assert abs(new.count - 4) <= 1  # the offset is that of all of it: a first guess


def plainest(samples, most, lost, seed):
    t = np.arange(samples + lost)
    path = 1e-3 * t + 0.1 * np.sin(0.01 * t)
    seen = np.delete(path, np.s_[700 : 700 + lost]) if lost else path
    seen = seen + 1e-3 * np.random.default_rng(seed).standard_normal(samples)
    group = SimpleNamespace(
        repeats=1, measured_um=seen[None], predicted=lambda model: path[:samples],
        blocks=((0, samples),), drive_v=path[:samples],
    )  # fmt: skip
    sweep = SimpleNamespace(drive_v=path[:samples])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recounted, "sweep_bounds", lambda *_: [(0, samples)])
        return recounted._plainest(
            SimpleNamespace(groups=[group]), SimpleNamespace(model=None), [sweep], {0},
            range(1, most + 1),
        )  # fmt: skip
