"""Drives that turn between samples, and drives whose very samples were played."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Elements, Maxwell, Model, Signal
from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.between import denser, turn_between
from piezo_rig.run_file.sweep import Sweep
from tests.diagnosis.sliders import play

RATE, FINER = 2000.0, 16
DRIVES = ((75.0, 7.3), (40.0, 13.7), (60.0, 3.1))  # V, Hz
LIMITS = np.linspace(0.5, 30.0, 40)


def triangle(time, high, hz):
    return high * (1.0 - np.abs(2.0 * ((hz * time) % 1.0) - 1.0))


def turns_of(high, hz, end_s):
    """Times and volts of all turning points of a triangle, but for where it begins."""
    number = np.arange(1, int(2.0 * hz * end_s) + 1)
    return number / (2.0 * hz), np.where(number % 2, high, 0.0)


@pytest.mark.parametrize(("high", "hz"), [*DRIVES, (20.0, 31.0)])
def test_lines_meet_where_the_drive_turned(high, hz):
    time = np.arange(2000) / RATE
    found = denser(time, triangle(time, high, hz))
    at, volts = turns_of(high, hz, time[-1] - 3.0 / RATE)
    between = np.abs(at * RATE - np.round(at * RATE)) > 0.05
    there = found.time_s[~found.given], found.drive_v[~found.given]
    for t, v in zip(at[between], volts[between], strict=True):
        k = np.argmin(np.abs(there[0] - t))
        assert there[0][k] == pytest.approx(t, abs=1e-9)
        assert there[1][k] == pytest.approx(v, abs=1e-9)
    assert np.array_equal(found.drive_v[found.given], triangle(time, high, hz))
    assert np.all(np.diff(found.time_s) > 0.0)


@pytest.mark.parametrize("drive", [
    lambda t: triangle(t, 75.0, 2.0), lambda t: 37.5 * (1.0 - np.cos(2.0 * np.pi * 7.3 * t)),
    lambda t: np.minimum(240.0 * t, 60.0), lambda t: 0.0 * t,
    lambda t: np.random.default_rng(1).uniform(0.0, 75.0, t.size),
])  # fmt: skip
def test_nothing_is_added_where_no_straight_lines_meet_between_samples(drive):
    time = np.arange(2000) / RATE
    assert denser(time, drive(time)) is None


@pytest.mark.parametrize("step", [3e-4, 2e-3, 5e-3])
@pytest.mark.parametrize(("high", "hz"), [(15.0, 3.7), (60.0, 3.1), (75.0, 7.3)])
def test_lines_meet_where_a_drive_turned_that_was_rounded_when_it_was_recorded(high, hz, step):
    """A code too many or too few on every sample: lines through many of them, by their scatter."""
    time = np.arange(4000) / 5000.0
    drive = step * np.round(triangle(time, high, hz) / step)
    found = denser(time, drive)
    at, volts = turns_of(high, hz, time[-1] - 20.0 / 5000.0)
    share = at * 5000.0 - np.floor(at * 5000.0)
    between = np.abs(share - 0.5) < 0.4
    there = found.time_s[~found.given], found.drive_v[~found.given]
    for t, v in zip(at[between], volts[between], strict=True):
        k = np.argmin(np.abs(there[0] - t))
        assert abs(there[1][k] - v) < step
        assert abs(there[0][k] - t) * 5000.0 < step / (2.0 * high * hz / 5000.0)


@pytest.mark.parametrize("step", [3e-4, 2e-3, 2e-2])
@pytest.mark.parametrize("drive", [
    lambda t: 37.5 * (1.0 - np.cos(2.0 * np.pi * 1.3 * t)), lambda t: 3.0 * t, lambda t: 0.0 * t,
    lambda t: np.random.default_rng(1).uniform(0.0, 75.0, t.size),
    lambda t: 30.0 + 0.5 * np.cumsum(np.random.default_rng(2).standard_normal(t.size)),
])  # fmt: skip
def test_rounding_alone_makes_no_corner(drive, step):
    time = np.arange(4000) / 5000.0
    assert denser(time, step * np.round(drive(time) / step)) is None


def test_a_ramp_begins_and_ends_where_its_line_meets_the_holds():
    time = np.arange(2000) / RATE
    found = denser(time, np.clip(300.0 * (time - 0.10013), 0.0, 50.0))
    there = found.time_s[~found.given], found.drive_v[~found.given]
    assert there[0] == pytest.approx([0.10013, 0.10013 + 50.0 / 300.0], abs=1e-9)
    assert there[1] == pytest.approx([0.0, 50.0], abs=1e-9)


@pytest.mark.parametrize("tau", [2e-5, 7e-5, 3e-4])
def test_a_lag_behind_a_fast_sine_is_that_of_the_sine(tau):
    time, w = np.arange(5000) / 5000.0, 2.0 * np.pi * 60.0
    drive = 37.5 * np.sin(w * time)
    found = denser(time, drive)
    lag = CAUSES["amplifier-lag"].of(None, tau=tau)

    def error(t, v, given):
        seen = lag.act(Signal(t, v, np.zeros(t.size))).drive_v[given][500:-3]
        lagging = 37.5 * np.imag(np.exp(1j * w * time) / (1.0 + 1j * w * tau))[500:-3]
        return float(np.abs(seen - lagging).max())

    assert error(*found) < 3e-3
    assert error(*found) < 0.2 * error(time, drive, np.ones(time.size, bool))


def test_a_slew_limit_turns_where_it_meets_the_drive():
    time = np.arange(1500) / 5000.0
    drive = triangle(time, 75.0, 4.0)  # 600 V/s, turns at a sample
    model = Model((Maxwell.of(Elements.from_curve(np.array([1.0, 75.0]), np.array([0.1, 0.1]))),),
                  {}, "")  # fmt: skip
    assert denser(time, drive, model) is None
    limited = model.with_stage(CAUSES["slew-limit"].of(None, limit=540.0))
    found = denser(time, drive, limited)
    # up at 540 V/s until 75 V - 600 V/s x (t - 0.125 s)
    assert found.time_s[~found.given][0] == pytest.approx(150.0 / 1140.0, abs=1e-9)


def recordings(finer, seed=0, noise_um=1e-3):
    """Three triangles, twice each, of a body that follows what lies between samples, or does not.
    """
    rng, out = np.random.default_rng(seed), []
    for k, (high, hz) in enumerate(DRIVES):
        time = np.arange(int(1.2 * RATE) * finer) / (RATE * finer)
        moved = play(triangle(time, high, hz), LIMITS, 0.002)[::finer]
        for repeat in range(2):
            seen = moved + noise_um * rng.standard_normal(moved.size)
            out.append(Sweep(
                f"sweep_{2 * k + repeat + 1:04d}", triangle(time[::finer], high, hz), seen, RATE,
                1.0, 0.0, 1.0, 1, 0.0, f"{high:g} V at {hz:g} Hz", repeat + 1, "virgin",
                60.0 * (2 * k + repeat), "SIMULATED",
            ))  # fmt: skip
    return out


@pytest.mark.study
@pytest.mark.parametrize("finer", [FINER, 1])
def test_a_body_with_nothing_hidden_is_silent_whatever_lies_between_samples(finer):
    out = diagnose(recordings(finer))
    assert out.findings == []
    assert not out.unexplained.detected
    assert any("turns between samples" in note for note in out.notes) == (finer > 1)
    assert out.rungs[-1].rms_nm < 1.1  # of a noise of 1


@pytest.mark.parametrize(("said", "with_corners", "best", "turns"), [
    (-5080.3, -5060.0, None, True), (-5080.3, -5072.0, None, False),
    (-5099.3, -5087.1, -5080.3, False),  # a rival gains by them, and says less than another does
    (-5132.4, -5066.9, -5080.3, False),  # hardly more than that: both may lack half of it
    (-5132.4, -5025.0, -5080.3, True),
])  # fmt: skip
def test_corners_that_a_rival_asks_for_must_say_far_more_than_the_best_fit(
    monkeypatch, said, with_corners, best, turns
):
    def fit(evidence):
        return SimpleNamespace(evidence=evidence, point=SimpleNamespace(model=None), linear=None)

    groups = SimpleNamespace(groups=[SimpleNamespace(denser=None)], turned=lambda model: "turned")
    plain = SimpleNamespace(groups=groups, whitener=None, own_um=0.0, loose=False)
    corners, rival, less = SimpleNamespace(), fit(said), fit(-5200.0)
    there = {id(rival): with_corners, id(less): -5300.0}
    worth = {id(plain): {id(rival): said}, id(corners): there}
    monkeypatch.setattr("piezo_rig.diagnosis.engine.space_of", lambda *_: (corners, None))
    monkeypatch.setattr("piezo_rig.diagnosis.refit.refit", lambda space, point, held: point)
    monkeypatch.setattr(
        "piezo_rig.diagnosis.forms.converged", lambda space, point: fit(worth[id(space)][id(point)])
    )
    monkeypatch.setattr("piezo_rig.diagnosis.put_in.much_left", lambda *_: False)
    monkeypatch.setattr("piezo_rig.diagnosis.between._shows", lambda *_: True)
    monkeypatch.setattr("piezo_rig.diagnosis.between._left", lambda fitted: -fitted.evidence)
    rival.point = rival
    less.point = less
    rival.model = None
    other = None if best is None else fit(best)
    assert turn_between(plain, rival, less, best=other) == turns
    assert turn_between(plain, rival, less, best=rival) == (with_corners > said + 10.0)
