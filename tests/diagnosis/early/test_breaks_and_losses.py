"""Jumps of the interferometer and lost samples: each found for what it is, and repaired."""

from __future__ import annotations

import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).parents[1]))
from small_bench import actuator, noise, recordings

from piezo_rig.causes import named_model
from piezo_rig.chain import Elements, Maxwell, Model
from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.early.breaks import _at_once, find_breaks
from piezo_rig.diagnosis.early.clean_up import clean_up
from piezo_rig.diagnosis.early.mended import Break, mended
from piezo_rig.diagnosis.early.peaks import Search, find_peaks
from piezo_rig.diagnosis.early.reported import events_of, reported
from piezo_rig.diagnosis.engine import plainly
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification import prepare
from piezo_rig.run_file import Sweep
from piezo_rig.studies.hidden import draw
from tests.diagnosis.sliders import play, recorded
from tests.more import first_of

LEVEL = 1e-4
# a plain loop: 0.09 um/V that grows to 0.15, about as the small bench's actuator
KNOTS = np.linspace(1.0, 40.0, 40)
MODEL = Model((Maxwell.of(Elements.from_curve(KNOTS, np.linspace(0.09, 0.15, 40))),))


def with_jump(sweep, index, steps):
    volts = sweep.sensor_v.copy()
    volts[index:] -= steps * 0.0791 / 15.48
    return sweep.with_(sensor_v=volts)


def with_loss(sweep, index, count):
    volts = np.delete(sweep.sensor_v, slice(index, index + count))
    return sweep.with_(sensor_v=np.append(volts, np.full(count, volts[-1])))


def searched(sweeps):
    groups = group_tracks(prepare(sweeps, first_rises=True), sweeps)
    found = find_breaks(groups, MODEL, sweeps, LEVEL)
    return groups, found.breaks


def said(groups, breaks):
    return sorted(
        (groups.groups[b.group].sweeps[b.row][0], b.cause, b.index, b.count) for b in breaks
    )


@pytest.mark.parametrize("kind", ["white", "ar", "1/f"])
def test_recordings_without_a_break_show_none(kind):
    assert searched(recordings(kind=kind, seed=2))[1] == ()


@pytest.mark.parametrize("kind", ["white", "ar", "1/f"])
@pytest.mark.parametrize("steps", first_of(1, [-3, 1]))
def test_a_jump_is_found_at_its_sample_in_the_right_one_of_two_recordings(kind, steps):
    sweeps = recordings(kind=kind)
    sweeps[6] = with_jump(sweeps[6], 1234, steps)
    groups, breaks = searched(sweeps)
    assert said(groups, breaks) == [(6, "fringe-jump", 1234, steps)]
    # of a step that large there is no doubt
    assert breaks[0].high - breaks[0].low <= 1


@pytest.mark.parametrize("count", [1, 3, 60])
def test_lost_samples_are_counted_and_not_taken_for_a_jump(count):
    sweeps = recordings()
    sweeps[2] = with_loss(sweeps[2], 1700, count)
    groups, breaks = searched(sweeps)
    ((sweep, cause, index, missing),) = said(groups, breaks)
    assert (sweep, cause, missing) == (2, "dropped-samples", count)
    assert abs(index - 1700) <= 2


@pytest.mark.parametrize("count", [25, 60])
def test_a_recording_that_is_shorter_for_it_is_a_repeat_all_the_same(count):
    sweeps = [s.with_(history="unknown") for s in recordings(seed=1)]
    lost = np.delete(sweeps[6].sensor_v, slice(900, 900 + count))
    sweeps[6] = sweeps[6].with_(sensor_v=lost, command_v=sweeps[6].command_v[: lost.size])
    groups, breaks = searched(sweeps)
    assert max(g.repeats for g in groups.groups) == min(g.repeats for g in groups.groups) == 2
    assert said(groups, breaks) == [(6, "dropped-samples", 900, count)]


def test_a_mended_recording_is_what_it_would_have_been():
    whole = recordings()
    sweeps = list(whole)
    sweeps[1] = with_loss(with_jump(whole[1], 900, 2), 1600, 3)
    groups, breaks = searched(sweeps)
    assert {b.cause for b in breaks} == {"fringe-jump", "dropped-samples"}
    clean = mended(groups, [g.predicted(MODEL) for g in groups.groups], breaks)
    true = group_tracks(prepare(whole, first_rises=True), whole)
    off = clean.groups[1].measured_um - true.groups[1].measured_um
    assert np.percentile(np.abs(off), 99) < 1e-9
    assert np.max(np.abs(off)) < 0.05  # in the gap: the model, and no noise


def test_a_step_of_another_size_is_no_jump():
    sweeps = recordings()
    volts = sweeps[3].sensor_v.copy()
    volts[1500:] -= 0.120 / 15.48
    sweeps[3] = sweeps[3].with_(sensor_v=volts)
    assert searched(sweeps)[1] == ()


def test_what_all_recordings_of_a_drive_share_is_no_accident():
    assert searched([with_jump(s, 1500, 1) for s in recordings()])[1] == ()


def test_hum_and_drift_are_neither():
    def sensor(x, t, rng):
        return x + 8e-3 * np.sin(2 * np.pi * 50.0 * t + 0.3) + 20e-6 * t

    assert searched(recordings(sensor=sensor))[1] == ()


def test_without_repeats_a_jump_is_found_against_the_model():
    sweeps = recordings(repeats=1)
    sweeps[2] = with_jump(sweeps[2], 1234, 2)
    groups, breaks = searched(sweeps)
    assert said(groups, breaks) == [(2, "fringe-jump", 1234, 2)]


def test_several_events_are_reported_as_lists_with_the_sweep_that_each_is_in():
    sweeps = recordings()
    sweeps[0] = with_jump(sweeps[0], 700, 1)
    sweeps[5] = with_jump(sweeps[5], 2000, -1)
    groups, breaks = searched(sweeps)
    events = events_of(groups, breaks, sweeps)
    parameters = reported("fringe-jump", events)
    assert parameters["sweep"].values == (1.0, 6.0)
    assert parameters["step"].values == pytest.approx((79.1, -79.1))
    assert parameters["time"].values == pytest.approx((0.35, 1.0))
    one = reported("fringe-jump", events[:1])
    assert one["step"].value in (79.1, -79.1)


@pytest.mark.parametrize(("first", "second"), first_of(1, [(946, 1195), (700, 1300), (1700, 900)]))
def test_both_recordings_of_a_drive_may_have_lost_a_sample(first, second):
    sweeps = recordings(seed=4)
    sweeps[1] = with_loss(sweeps[1], first, 1)
    sweeps[5] = with_loss(sweeps[5], second, 1)
    groups, breaks = searched(sweeps)
    assert [(s, c, n) for s, c, _, n in said(groups, breaks)] == [
        (1, "dropped-samples", 1), (5, "dropped-samples", 1)
    ]  # fmt: skip
    near = [abs(i - at) for (_, _, i, _), at in zip(said(groups, breaks), (first, second),
                                                   strict=True)]  # fmt: skip
    assert max(near) <= 4


def test_two_losses_in_a_row_are_two():
    sweeps = recordings(seed=1)
    sweeps[2] = with_loss(with_loss(sweeps[2], 1400, 1), 1200, 1)
    groups, breaks = searched(sweeps)
    assert [(s, n) for s, _, _, n in said(groups, breaks)] == [(2, 1), (2, 1)]
    assert all(abs(i - at) <= 4 for (_, _, i, _), at in zip(
        said(groups, breaks), (1200, 1399), strict=True
    ))  # fmt: skip


def walks(seed, kind, losses):
    """Two recordings of one walk of a few Hz; ``losses`` as (recording, played sample, count)."""
    rng = np.random.default_rng(seed)
    rate, n = 1000.0, 9000
    drive = np.convolve(rng.standard_normal(n + 400), np.hanning(200), "valid")[:n]
    drive = 35.0 + 8.0 * (drive - drive[0]) / drive.std()
    drive = np.clip(drive, 0.0, 75.0)
    x = actuator(seed)(drive)
    out = []
    for row in range(2):
        seen = x + noise(kind, n, rng)
        command = (drive - 75.0) / 7.5
        for index, count in sorted(((i, c) for r, i, c in losses if r == row), reverse=True):
            seen = np.delete(seen, slice(index, index + count))
        out.append(Sweep(
            name=f"sweep_{row + 1:04d}", command_v=command[: seen.size], sensor_v=-seen / 15.48,
            sample_rate=rate, gain=7.5, offset_v=75.0, sensitivity_um_per_v=15.48, polarity=-1,
            zero_v=-seen[0] / 15.48, condition="walk", repeat=row + 1, history="unknown",
            start_time=40.0 * row, origin="IMPORTED",
        ))  # fmt: skip
    return out


@pytest.mark.study
@pytest.mark.parametrize("kind", ["white", "ar", "1/f"])
@pytest.mark.parametrize("losses", [
    [], [(1, 5000, 9)], [(0, 1800, 5)], [(1, 6500, 40)], [(0, 3000, 12), (1, 6000, 7)],
    [(0, 2000, 30), (0, 5000, 6), (1, 7000, 40)],
])  # fmt: skip
def test_losses_are_found_where_the_drive_never_repeats_itself(kind, losses):
    _, breaks = searched(walks(4, kind, losses))
    found = sorted((b.row, b.index, b.count) for b in breaks)
    assert {b.cause for b in breaks} <= {"dropped-samples"}
    assert [(row, count) for row, _, count in found] == [(row, count) for row, _, count in losses]
    gone = [sum(c for r, i, c in losses if r == row and i < at) for row, at, _ in losses]
    for (_, index, _), (_, at, _), before in zip(found, losses, gone, strict=True):
        assert abs(index + before - at) <= 15


def test_recordings_that_hardly_differ_have_lost_nothing():
    # a coarse sensor: two recordings are the same but for some last digits in the second half
    first, second = walks(6, "white", [])
    volts = np.round(first.sensor_v, 3)
    other = volts.copy()
    other[6000::7] += 1e-3
    for changed in (volts, other):
        sweeps = [first.with_(sensor_v=volts), second.with_(sensor_v=changed, zero_v=first.zero_v)]
        assert searched(sweeps)[1] == ()


@pytest.mark.study
@pytest.mark.parametrize("seed", [0, 3, 4])
def test_steps_up_and_down_again_are_not_mended_for_the_worse(seed):
    # a random telegraph of 25 nm: for as long as the velocity lasts a step looks like a loss
    def telegraph(x, t, rng):
        return x + 0.0125 * (-1.0) ** np.cumsum(rng.random(t.size) < 3.0 / 2000.0)

    groups, breaks = searched(recordings(sensor=telegraph, kind="ar", repeats=3, seed=seed))

    def differing(some):
        whole = mended(groups, [g.measured_um.mean(axis=0) for g in groups.groups], some)
        rows = [g.measured_um - g.measured_um.mean(axis=0) for g in whole.groups]
        return sum(float(np.var(r, axis=1).mean()) for r in rows)

    assert differing(list(breaks)) <= differing([b for b in breaks if b.cause == "fringe-jump"])


@pytest.mark.study
def test_a_jump_after_another_one_is_no_loss_of_many_samples():
    # 18 samples' way is 79 nm there, until the drive turns
    sweeps = draw("fringe-jump", 1510, "rates", "white", 40.0, 2).sweeps
    half = len(sweeps) // 2
    jumps = [  # a step between the recordings of one drive, from sample to sample
        int(k) + 1
        for a, b in zip(sweeps[:half], sweeps[half:], strict=True)
        for k in np.flatnonzero(np.abs(np.diff(b.displacement_um - a.displacement_um)) > 0.04)
    ]
    assert len(jumps) == 3
    (finding,) = diagnose(sweeps).findings
    assert finding.cause == "fringe-jump"
    assert sorted(e.index for e in finding.events) == sorted(jumps)


@pytest.mark.parametrize("kind", ["white", "ar"])
def test_two_jumps_within_a_few_hundredths_of_a_second_are_two(kind):
    """What the second adds up to with the first is no whole number of its own."""
    sweeps = recordings(kind=kind)
    sweeps[6] = with_jump(with_jump(sweeps[6], 1150, 1), 1245, -4)
    groups, breaks = searched(sweeps)
    assert said(groups, breaks) == [(6, "fringe-jump", 1150, 1), (6, "fringe-jump", 1245, -4)]


def test_losses_at_one_sample_are_one_loss():
    loss = Break("dropped-samples", 0, 1, 700, 1, 698, 702, 2000, 1e-20)
    jump = replace(loss, cause="fringe-jump")
    other = replace(loss, row=0)
    together = _at_once([loss, jump, replace(loss, count=2, p_value=1e-9), other])
    assert together == [replace(loss, count=3), jump, other]


def test_jumps_that_undo_each_other_at_one_sample_are_none():
    jump = Break("fringe-jump", 0, 1, 700, 2, 698, 702, 2000, 1e-20)
    assert _at_once([jump, replace(jump, count=-2)]) == []


def test_what_gains_nothing_is_chance():
    # rounding has made it less than nothing
    assert Search(None, [], [], [], [], [], 100).chance(-1e-9) == 1.0


def sines_with_a_loss(seed=4):
    """Three sums of sines, each played once; of the second four samples are lost as it turns."""
    rng, t, out = np.random.default_rng(seed), np.arange(30000) / 5000.0, []
    for n in range(3):
        phases = rng.uniform(0.0, 2.0 * np.pi, 3)
        parts = zip((20.0, 10.0, 6.0), (0.9, 1.7, 2.6), phases, strict=True)
        drive = sum(a * np.cos(2.0 * np.pi * f * t + p) for a, f, p in parts)
        drive = np.minimum(1.0, t / 0.3) * (35.0 + (drive - drive[0]) * np.minimum(1.0, t / 0.5))
        x = play(drive, np.linspace(0.5, 30.0, 30), 0.03) + 2e-3 * rng.standard_normal(t.size)
        sweep = Sweep(
            f"sweep_{n + 1:04d}", drive, x, 5000.0, 1.0, 0.0, 1.0, 1, 0.0, f"sines {n}", 1,
            "virgin", 60.0 * n, "SIMULATED",
        )  # fmt: skip
        out.append(sweep)
    speed = np.gradient(out[1].command_v)
    turn = np.flatnonzero(speed[12000:-1] * speed[12001:] <= 0.0)[0] + 12000
    out[1] = with_loss(out[1], turn, 4)
    return out, turn


def cleaned(sweeps):
    groups = group_tracks(prepare(sweeps, first_rises=True), sweeps)
    start = Point(starting_model(groups, named_model("classical"), "classical"))
    point = plainly(groups, start).point
    return clean_up(groups, sweeps, point, lambda g, p: plainly(g, p).point, LEVEL, 25)[0]


@pytest.mark.study
def test_samples_lost_where_the_drive_stands_still_show_by_all_that_follows():
    """There they begin as a kink does, which any base may have."""
    sweeps, lost_at = sines_with_a_loss()
    (found,) = cleaned(sweeps)
    assert found.cause == "dropped-samples"
    ((event,), parameters) = found.events, found.parameters
    assert event.size == 4.0
    assert parameters
    assert abs(event.index - lost_at) < 0.06 * 5000.0


def stairs(hold_s, levels, rate=1000.0):
    """Steps of 20 ms between holds."""
    drive = [np.zeros(round(0.2 * rate))]
    for a, b in pairwise([0.0, *levels]):
        drive += [np.linspace(a, b, round(0.02 * rate) + 1)[1:], np.full(round(hold_s * rate), b)]
    return np.concatenate(drive)


@pytest.mark.parametrize("seed", first_of(1, [1, 2, 3]))
def test_jumps_among_the_steps_of_staircases_in_slow_noise_are_jumps(seed):
    """More of such noise goes like lost samples next to a step than like what has happened."""
    rng = np.random.default_rng(seed)
    drives = [
        stairs(0.4, [10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 50.0, 40.0, 30.0, 20.0, 10.0, 0.0]),
        stairs(0.3, [25.0, 50.0, 70.0, 45.0, 20.0, 45.0, 70.0, 35.0, 0.0]),
        stairs(0.5, [15.0, 35.0, 20.0, 55.0, 25.0, 65.0, 0.0]),
    ]
    out = []
    for n in range(6):
        drive = drives[n % 3]
        x = play(drive, np.linspace(0.5, 35.0, 30), 0.03) + lfilter(
            [3e-3 * np.sqrt(1.0 - 0.81)], [1.0, -0.9], rng.standard_normal(drive.size)
        )
        if n in (2, 3):  # a while after a step, one up and one down
            x[2000 + 100 * n :] += 0.0791 if n == 2 else -0.0791
        out.append(Sweep(
            f"sweep_{n + 1:04d}", drive, x, 1000.0, 1.0, 0.0, 1.0, 1, 0.0, f"stairs {n % 3}",
            1 + n // 3, "virgin", 60.0 * n, "SIMULATED",
        ))  # fmt: skip
    (found,) = cleaned(out)
    assert found.cause == "fringe-jump"
    assert sorted((e.sweep, e.index, e.size) for e in found.events) == [
        ("sweep_0003", 2200, 79.1), ("sweep_0004", 2300, -79.1),
    ]  # fmt: skip


@pytest.mark.parametrize("seed", first_of(1, [0, 1, 2]))
def test_a_jump_by_as_much_as_a_sine_goes_in_some_samples_is_a_jump(monkeypatch, seed):
    """Where some 35 lost samples look like it for a while, and happen to say a little more."""
    def peaks(search):
        return [
            replace(p, gained=1.05 * p.gained) if p.cause == "dropped-samples" else p
            for p in find_peaks(search)
        ]  # fmt: skip

    monkeypatch.setattr("piezo_rig.diagnosis.early.breaks.find_peaks", peaks)
    rng, rate = np.random.default_rng(seed), 10000.0
    time = np.arange(13334) / rate
    sweeps = []
    for number, top in enumerate((40.0, 75.0, 40.0, 75.0), start=1):
        drive = 0.5 * top * (1.0 - np.cos(2.0 * np.pi * 3.0 * time))
        seen = play(drive, np.linspace(0.5, 36.0, 72), 0.0015)
        seen += 3e-3 * rng.standard_normal(seen.size)
        if number == 3:
            seen[6000:] -= 2 * 0.0791
        sweeps.append(recorded(
            drive, seen - seen[0], rate, "unknown", number, f"0-{top:g}", 1 + (number > 2)
        ))  # fmt: skip
    groups, breaks = searched(sweeps)
    assert said(groups, breaks) == [(2, "fringe-jump", 6000, -2)]


@pytest.mark.parametrize("at", first_of(1, [1433, 1434]))
def test_a_jump_of_many_steps_is_counted_at_sight(at):
    """Over one walk, three times: it is most of what the noise is taken for, and half of it falls
    into an averaged sample.
    """
    time, rng = np.arange(4000) / 2000.0, np.random.default_rng(0)
    drawn = np.random.default_rng(4)
    corners = np.append(0.0, np.cumsum(drawn.uniform(0.05, 0.2, 60)))
    drive = np.interp(time, corners, np.append(0.0, drawn.uniform(0.0, 75.0, 60)))
    moved, sweeps = play(drive, np.linspace(0.5, 30.0, 30), 0.0016), []
    for number in range(3):
        seen = moved + 2e-3 * rng.standard_normal(time.size)
        seen[at:] += 5 * 0.0791 * (number == 1)
        sweeps.append(recorded(drive, seen, 2000.0, "unknown", number, "walk", number + 1))
    groups = group_tracks(prepare(sweeps), sweeps)
    model = plainly(groups, Point(starting_model(groups, (), "classical"))).point.model
    found = find_breaks(groups, model, sweeps, LEVEL)
    assert said(groups, found.breaks) == [(1, "fringe-jump", at, 5)]
