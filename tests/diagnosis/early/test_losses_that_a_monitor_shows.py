"""Samples that a digitizer lost are where the drive monitor comes earlier, and stays so.

Monitors are made here sample by sample, by code that the program does not share.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).parent.parent))
from small_bench import RATE, recordings

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.early import losses_of_monitors, with_monitors_mended
from piezo_rig.diagnosis.early.seen_by_monitor import _losses
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification import prepare

STEP_V = 128.0 / 2**15
N, FINE = 6000, 10
TIME = np.arange(2 * N * FINE) / (RATE * FINE)  # in which drives are known to a tenth of a sample


def triangles():
    return 10.0 + 65.0 * (1.0 - np.abs((4.0 * TIME) % 2.0 - 1.0))


def sines():
    return 40.0 + 30.0 * np.sin(2.0 * np.pi * 24.0 * TIME)


def walk():
    rng = np.random.default_rng(3)
    ends = np.concatenate([[10.0], rng.uniform(10.0, 75.0, 60)])
    lengths = FINE * np.maximum((np.abs(np.diff(ends)) / 500.0 * RATE).astype(int), 1)
    at = np.concatenate([[0], np.cumsum(lengths)])
    return np.interp(np.arange(TIME.size), at, ends)


def stairs():
    """Loops of 65, 40 and 20 V, one amplitude after the other."""
    size = np.repeat([65.0, 40.0, 20.0], FINE * N // 3)
    size = np.concatenate([size, np.full(TIME.size - size.size, 20.0)])
    return 10.0 + size * (1.0 - np.abs((8.0 * TIME) % 2.0 - 1.0))


DRIVES = {"triangles": triangles, "sines": sines, "walk": walk, "stairs": stairs}


def played(made):
    """What the waveform has at every sample of a recording."""
    return made[::FINE][:N]


def heard(made, lost=(), late=4, noise=3e-3, seed=1):
    """The monitor of a drive, late by tenths of a sample, without the samples that were lost."""
    rng = np.random.default_rng(seed)
    seen = 0.03 + 1.002 * np.concatenate([np.full(late, made[0]), made])[:-late or None][::FINE]
    kept = np.ones(seen.size, bool)
    for index, count in lost:
        kept[np.flatnonzero(kept)[index : index + count]] = False
    seen = seen[kept][:N] + noise * rng.standard_normal(N)
    return np.round(seen / STEP_V) * STEP_V


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("count", [1, 3, 20])
@pytest.mark.parametrize("at", [700, 3111, 5300])
def test_a_loss_is_counted_and_placed_between_samples_of_which_it_is_one(drive, count, at):
    made = DRIVES[drive]()
    (found,) = _losses(played(made), heard(made, [(at, count)]))
    assert found.count == count
    assert found.low <= at <= found.high
    assert abs(found.index - at) <= 2
    assert found.chance < 1e-12


@settings(max_examples=25, deadline=None)
@given(
    drive=st.sampled_from(["triangles", "walk"]),
    places=st.lists(st.integers(5, 50), min_size=1, max_size=4, unique=True),
    counts=st.lists(st.integers(1, 9), min_size=4, max_size=4),
    seed=st.integers(0, 2**16),
)
def test_all_losses_of_a_recording_are_found_and_none_besides(drive, places, counts, seed):
    lost = [(100 * p, c) for p, c in zip(sorted(places), counts, strict=False)]
    made = DRIVES[drive]()
    found = _losses(played(made), heard(made, lost, seed=seed))
    assert [f.count for f in found] == [c for _, c in lost]
    for (at, _), f in zip(lost, found, strict=True):
        assert f.low - 1 <= at <= f.high + 1 or abs(f.index - at) <= 2


def lagging(drive, samples):
    share = 1.0 - np.exp(-1.0 / samples / FINE)
    return drive[0] + lfilter([share], [1.0, share - 1.0], drive - drive[0])


def limited(drive, share):
    """No faster than a share of the fastest change."""
    most = share * float(np.max(np.abs(np.diff(drive))))
    out = drive.copy()
    for i in range(1, out.size):
        out[i] = out[i - 1] + np.clip(drive[i] - out[i - 1], -most, most)
    return out


def by_another_clock(drive, ppm):
    at = np.arange(drive.size, dtype=float)
    return np.interp(at * (1.0 + 1e-6 * ppm), at, drive)


AMPLIFIERS = {
    "nothing": lambda v: v,
    "lag": lambda v: lagging(v, 12.0),
    "limit": lambda v: limited(v, 0.97),
    "clipped": lambda v: np.minimum(v, 60.0),
    "clock fast": lambda v: by_another_clock(v, 400.0),
    "clock slow": lambda v: by_another_clock(v, -400.0),
    "divider": lambda v: 0.5 * v,
    "not wired": lambda v: 0.0 * v,
    "of another drive": lambda v: v[::-1].copy(),
}  # fmt: skip


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("amplifier", AMPLIFIERS)
def test_no_samples_are_lost_where_only_the_amplifier_or_a_clock_is_amiss(drive, amplifier):
    made = DRIVES[drive]()
    assert _losses(played(made), heard(AMPLIFIERS[amplifier](made), late=0)) == []


@pytest.mark.parametrize("drive", ["triangles", "walk"])
@pytest.mark.parametrize("amplifier", ["lag", "limit", "clock fast", "divider"])
def test_a_loss_is_seen_beside_what_the_amplifier_does(drive, amplifier):
    made = DRIVES[drive]()
    found = _losses(played(made), heard(AMPLIFIERS[amplifier](made), [(2500, 5)]))
    assert [f.count for f in found] == [5]
    assert abs(found[0].index - 2500) < 60


SPEEDS = (("0-30", 0.0, 30.0, 10.0), ("0-75", 0.0, 75.0, 4.0), ("0-60", 0.0, 60.0, 10.0))
CUT, MISSING = 700, 6


def recorded(sensor_too=True):
    """Every drive once; of the second the digitizer lost samples."""
    rng = np.random.default_rng(8)
    out = []
    for s in recordings(conditions=SPEEDS, repeats=1):
        monitor = s.drive_v + 2e-3 * rng.standard_normal(s.samples)
        sensor = s.sensor_v
        if s.condition == "0-75":
            monitor = cut(monitor)
            sensor = cut(sensor) if sensor_too else sensor
        out.append(s.with_(drive_monitor_v=monitor, sensor_v=sensor))
    return out


def cut(volts):
    return np.concatenate([volts[:CUT], volts[CUT + MISSING :], np.full(MISSING, volts[-1])])


def test_mended_monitors_follow_their_drives():
    sweeps = recorded()
    groups = group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)
    (loss,) = losses_of_monitors(groups, sweeps)
    assert (loss.index, loss.count, loss.sure) == (CUT, MISSING, True)
    for s in with_monitors_mended(sweeps, groups, [loss]):
        assert s.drive_monitor_v is not None
        assert np.abs(s.drive_monitor_v - s.drive_v).max() < 0.02


def test_a_loss_that_the_monitor_shows_is_the_only_finding():
    found = diagnose(recorded(), "classical")
    assert [f.cause for f in found.findings] == ["dropped-samples"]
    (event,) = found.findings[0].events
    assert event.size == MISSING
    assert not found.unexplained.detected


def test_a_loss_in_the_monitors_channel_alone_is_no_finding():
    found = diagnose(recorded(sensor_too=False), "classical")
    assert found.findings == []
    assert not found.unexplained.detected
