"""Samples lost under a smooth drive, in one recording alone, are no clock that runs off.

A base that is fitted to all of it is late before the loss and early after it.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfiltfilt

from piezo_rig.causes import named_model
from piezo_rig.diagnosis import diagnose, in_turns
from piezo_rig.diagnosis.engine import plainly
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.in_turns import InTurns
from piezo_rig.diagnosis.refusals import FITS
from piezo_rig.identification import prepare
from tests.diagnosis.sliders import play, recorded

RATE, SECONDS, NOISE_UM, LOUD_UM = 2000.0, 24.0, 2e-3, 4e-3


def smooth(seed: int, samples: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    noise = sosfiltfilt(butter(2, 2.0, fs=RATE, output="sos"), rng.standard_normal(samples + 4000))
    noise = noise[2000 : samples + 2000] / noise.std()
    return 37.0 + 35.0 * np.tanh(0.8 * noise)


@pytest.mark.study
@pytest.mark.parametrize(("seed", "lost"), [(1, 3), (4, 6)])
def test_a_loss_under_a_smooth_drive_is_found_where_it_is(seed, lost):
    samples = int(RATE * SECONDS)
    drive = smooth(seed, samples + 100)
    third = samples // 3
    at = third + int(np.argmax(np.abs(np.gradient(drive[third : 2 * third]))))
    up = np.linspace(0.0, 75.0, 1000)
    before = np.concatenate([up, up[::-1], np.linspace(0.0, drive[0], 500)])
    moved = play(np.concatenate([before, drive]), np.linspace(0.5, 36.0, 72), 0.003)[before.size :]
    kept = np.delete(np.arange(samples + lost), np.s_[at : at + lost])
    rng = np.random.default_rng(100 + seed)
    seen = (moved - moved[0])[kept] + NOISE_UM * rng.standard_normal(samples)
    found = diagnose([recorded(drive[:samples], seen, RATE, "unknown")])
    assert [f.cause for f in found.findings] == ["dropped-samples"]
    (event,) = found.findings[0].events
    assert event.size == lost
    assert abs(event.time_s - at / RATE) < 3.0 / RATE
    assert not found.unexplained.detected


@pytest.mark.study
def test_a_second_loss_and_a_lag_behind_what_looks_like_a_clock():
    """The lag hides a part of either loss from the base, and the clock takes most of the rest."""
    rate, samples, tau_s = 5000.0, 49_500, 0.44e-3
    t = np.arange(samples + 100) / rate
    rng = np.random.default_rng(7)
    drive = sum(
        rng.uniform(0.4, 1.0) * np.sin(2.0 * np.pi * f * t + rng.uniform(0.0, 6.28))
        for f in (0.45, 0.9, 1.7, 2.4)
    )
    drive = 75.0 * (drive - drive.min()) / np.ptp(drive) * np.minimum(t / 0.6, 1.0)
    keeps = np.exp(-1.0 / (rate * tau_s))
    late = lfilter([1.0 - keeps], [1.0, -keeps], drive)
    moved = play(late, np.linspace(0.5, 36.0, 72), 0.003)
    lost = {7786: 14, 33_092: 4}
    kept = np.delete(np.arange(samples + 18), np.concatenate([
        np.arange(at, at + count) for at, count in lost.items()
    ]))  # fmt: skip
    seen = moved[kept] + 3.7e-3 * rng.standard_normal(samples)
    found = diagnose([recorded(drive[:samples], seen, rate)])
    named = {f.cause: f for f in found.findings}
    assert set(named) == {"dropped-samples", "amplifier-lag"} or (
        set(named) == {"dropped-samples", "time-skew"}
        and "amplifier-lag" in named["time-skew"].alternatives
    )
    assert [e.size for e in named["dropped-samples"].events] == list(lost.values())
    assert not found.unexplained.detected


def sines(rng: np.random.Generator, samples: int, rate: float) -> np.ndarray:
    t = np.arange(samples) / rate
    drive = sum(
        rng.uniform(0.4, 1.0) * np.sin(2.0 * np.pi * f * t + rng.uniform(0.0, 6.28))
        for f in (0.45, 0.9, 1.7, 2.4)
    )
    return 75.0 * (drive - drive.min()) / np.ptp(drive) * np.minimum(t / 0.6, 1.0)


@pytest.mark.study
@pytest.mark.parametrize(("seed", "lost"), [(1, 3), (6, 0)])
def test_a_clock_that_predicts_other_recordings_worse_may_be_a_loss_in_one(seed, lost):
    """In 1/f noise, behind a jump: the loss is not plain at its place."""
    rate, samples, rng = 2000.0, 17_000, np.random.default_rng(seed)
    at, size, sweeps = round(0.8 * samples), 1 << 18, []
    for k in range(3):
        drive = sines(rng, samples + 100, rate)
        moved = play(drive, np.linspace(0.5, 36.0, 72), 0.003)
        kept = np.arange(samples)
        if k == 1:
            kept[at:] += lost
        f = np.maximum(np.arange(size // 2 + 1), 1) / size
        pink = np.fft.irfft(np.fft.rfft(rng.standard_normal(size)) / np.sqrt(f), size)[:samples]
        seen = moved[kept] + LOUD_UM * pink / pink.std()
        if k == 1:
            seen += 0.1582 * (np.arange(samples) >= samples // 2)
        one = recorded(drive[:samples], seen, rate, number=k + 1, condition=f"sines {k + 1}")
        sweeps.append(replace(one, start_time=100.0 * k))
    raw = group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)
    start = plainly(raw, Point(starting_model(raw, named_model("classical"), "classical")))
    turns = InTurns(raw, sweeps, start, np.random.default_rng(0), lambda *_: None, False)
    turns._begin()
    assert [e.cause for e in turns.early] == ["fringe-jump"]
    refused = SimpleNamespace(refused={"clock-ratio": FITS + "worse (4.55 nm against 4.33 nm)"})
    ladder = SimpleNamespace(steps=[], scans=[refused], last=turns.start)
    turns.search = SimpleNamespace(monitored=[], ladder=ladder)
    assert turns._other_losses() == (lost > 0)
    losses = [b for e in turns.early for b in e.breaks if b.cause == "dropped-samples"]
    assert [(b.group, b.count) for b in losses] == ([(1, lost)] if lost else [])
    assert all(abs(b.index - at) < 0.02 * samples for b in losses)


@pytest.mark.parametrize(("steps", "why", "asked"), [
    (["clock-ratio"], "", True),
    ([], FITS + "worse (4.55 nm against 4.33 nm)", True),
    (["creep"], FITS + "worse beyond doubt", True),
    (["creep"], "once refitted it says no more than the model without it", False),
    (["creep"], "", False),
])  # fmt: skip
def test_losses_are_asked_for_behind_a_clock_that_is_taken_or_fits_and_predicts_worse(
    steps, why, asked
):
    ladder = SimpleNamespace(
        steps=[SimpleNamespace(cause=c) for c in steps],
        scans=[SimpleNamespace(refused={"clock-ratio": why} if why else {})],
    )
    turns = SimpleNamespace(search=SimpleNamespace(monitored=[], ladder=ladder))
    assert InTurns._like_a_clock(turns) == asked


@pytest.mark.parametrize(("fewer", "leaves", "given_up"), [
    (0, 0.9, True), (0, 1.1, False),  # of what losses and a clock leave
    (2, 0.9, False),  # as many are found
])  # fmt: skip
def test_losses_are_given_up_where_fewer_leave_less_than_they_and_a_clock(
    monkeypatch, fewer, leaves, given_up
):
    def lost(count):
        events = [SimpleNamespace(size=count)]
        return [SimpleNamespace(cause="dropped-samples", events=events, groups=None)]

    monkeypatch.setattr(in_turns, "plainly", lambda groups, point: SimpleNamespace(point=point))
    monkeypatch.setattr(in_turns, "square_of", lambda groups, point, members: leaves)
    turns = SimpleNamespace(early=lost(2), raw=None, alone={0})
    found = lost(fewer) if fewer else []
    assert InTurns._never_lost(turns, found, None, 1.0) == given_up
