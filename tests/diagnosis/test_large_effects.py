"""Effects of 400 times the noise: the cause is named, alone, and nothing is left unexplained.

So large, every assumption of a law shows: the even spectrum of creep (three relaxations here), and
what becomes of a loop that is closed exactly.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.signal

sys.path.insert(0, str(Path(__file__).parent))
from small_bench import CONDITIONS, RATE, recordings, relaxation
from spaces import begun, with_member

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.climb import Search
from piezo_rig.diagnosis.isolability import isolability
from piezo_rig.diagnosis.ladder import Step
from piezo_rig.diagnosis.refit import ASTRAY, _moved, refit, settle, square_of
from piezo_rig.diagnosis.spare import _gained_nothing, _stands_in
from piezo_rig.studies.hidden import draw


@pytest.mark.study
@pytest.mark.parametrize(
    ("kind", "seed", "protocol"),
    [("creep", 701, "matrix"), ("range-dependence", 700, "matrix")],
)
def test_a_large_effect_is_named_alone_and_leaves_nothing(kind, seed, protocol):
    case = draw(kind, seed, protocol, "white", 400.0, 2)
    found = diagnose(case.sweeps)
    assert [f.cause for f in found.findings] == [kind]
    assert not found.unexplained.detected
    assert found.rungs[-1].rms_nm < 1.03 * 2.0  # of noise
    for name, true in case.truth.parameters[kind].items():
        if name != "offset":
            low, high = found.findings[0].parameters[name].ci95
            assert low - 0.25 * (high - low) < true < high + 0.25 * (high - low)


@pytest.mark.study
@pytest.mark.parametrize(
    ("kind", "seed", "protocol"),
    [("range-dependence", 1481, "holds"), ("sensor-clipping", 1480, "matrix")],
)
def test_no_table_of_its_own_for_the_first_rise_makes_up_for_what_a_large_effect_left(
    kind, seed, protocol
):
    # a law in another form than the catalogue's; a level that moves when a bend is taken in
    case = draw(kind, seed, protocol, "white", 300.0, 2)
    found = diagnose(case.sweeps)
    assert [f.cause for f in found.findings] == [kind]
    assert not found.unexplained.detected


@pytest.mark.study
def test_the_window_of_a_rate_law_moves_when_the_lag_beside_it_is_named():
    case = draw("pair", 1481, "holds", "white", 300.0, 2)
    space, plain = begun(case.sweeps)
    # as it comes out while nobody has named the lag
    rate = with_member(plain, "rate-dependence", {"lag_um": 0.01, "exponent": 0.1},
                       lag_um=0.3, exponent=0.9, window_s=6e-3, widens=0.0)  # fmt: skip
    lag = with_member(rate, "amplifier-lag", {"tau": 1e-4}, tau=3e-3)
    steps = [Step("rate-dependence", 0.0, refit(space, rate, held=True)),
             Step("amplifier-lag", 0.0, refit(space, lag, held=True))]  # fmt: skip
    search = Search(space, steps[0].fitted, np.random.default_rng(0), lambda text: None,
                    [], 2.0, 0, lambda less, full: True, steps)  # fmt: skip
    assert search.fitted.point.model.stage("rate-dependence")["window_s"] == 6e-3
    search.scan_anew()
    for cause, parameters in case.truth.parameters.items():
        stage = search.fitted.point.model.stage(cause)
        for name, true in parameters.items():
            assert stage[name] == pytest.approx(true, rel=0.05)
    assert search.fitted.point.model.stage("rate-dependence")["window_s"] == pytest.approx(
        3e-3, rel=0.05
    )


@pytest.mark.study
@pytest.mark.parametrize(
    ("frequency", "damping", "share"), [(330.0, 0.02, 1.0), (220.0, 0.02, 0.6)]
)
def test_a_mode_that_carries_the_actuator_is_named_alone(frequency, damping, share):
    # the equation of motion by scipy; at 20 Hz every ring reaches into the next half loop
    omega = 2.0 * np.pi * frequency
    mode = ([omega**2], [1.0, 2.0 * damping * omega, omega**2])

    def riding(x, drive, t):
        return x + share * (scipy.signal.lsim(mode, x - x[0], t)[1] + x[0] - x)

    conditions = (("2 Hz", 0.0, 60.0, 2.0), ("8 Hz", 0.0, 60.0, 8.0), ("20 Hz", 0.0, 60.0, 20.0),
                  ("8 Hz, small", 0.0, 30.0, 8.0))  # fmt: skip
    found = diagnose(recordings(riding, seed=1, conditions=conditions))
    assert [f.cause for f in found.findings] == ["resonance"]
    assert not found.unexplained.detected
    assert found.rungs[-1].rms_nm < 1.03 * 2.0  # of noise
    said = found.findings[0].parameters
    assert said["frequency"].value == pytest.approx(frequency, rel=1e-3)
    assert said["damping"].value == pytest.approx(damping, rel=0.02)
    assert said["share"].value == pytest.approx(share, rel=0.01)


@pytest.mark.study
def test_a_slew_limit_just_above_the_speed_of_another_half_loop_is_named_alone():
    # 35 V at 12 Hz are 840 V/s and go through it whole, 70 V at 12 Hz are 1680 V/s and do not
    limit, fine = 900.0, 16

    def slowed(drive):
        """Towards the drive in small steps, straight between samples."""
        goal = np.interp(np.arange((drive.size - 1) * fine + 1) / fine, range(drive.size), drive)
        out, here, most = [], goal[0], limit / RATE / fine
        for v in goal.tolist():
            here += min(max(v - here, -most), most)
            out.append(here)
        return np.array(out[::fine])

    conditions = (("2 Hz", 0.0, 70.0, 2.0), ("12 Hz, small", 0.0, 35.0, 12.0),
                  ("12 Hz", 0.0, 70.0, 12.0))  # fmt: skip
    found = diagnose(recordings(before=slowed, seed=1, conditions=conditions))
    assert [f.cause for f in found.findings] == ["slew-limit"]
    assert not found.unexplained.detected
    assert found.rungs[-1].rms_nm < 1.03 * 2.0  # of noise
    assert found.findings[0].parameters["limit"].value == pytest.approx(limit, rel=1e-3)


@pytest.mark.study
def test_a_first_rise_of_its_own_among_minor_loops_is_not_told_from_its_own_density():
    # one first rise alone: the smooth density that the base has for it could do all of it
    case = draw("pair", 1497, "minor_loops", "white", 150.0, 2, "A")
    found = diagnose(case.sweeps)
    assert {f.cause for f in found.findings} == {"initiation-stage", "direction-asymmetry"}
    assert not found.unexplained.detected
    assert all(f.d_prime > 10.0 and not f.alternatives for f in found.findings)
    table = isolability(found.workings.space, found.workings.last)
    row = table.causes.index("initiation-stage")
    assert table.d_prime[row] == pytest.approx(found.findings[-1].d_prime, rel=1e-6)
    assert table.told[row][np.arange(len(table.causes)) != row].all()


@pytest.mark.study
def test_a_slow_mode_that_carries_everything_is_followed_to_where_it_is():
    # its frequency moves by 8 Hz on the way: a tangent that is kept leads to 85 Hz, or nowhere
    def rides(x, drive, t):
        w = 2.0 * np.pi * 95.0
        b, a, _ = scipy.signal.cont2discrete(([w**2], [1.0, 2 * 0.05 * w, w**2]), 1 / RATE, "foh")
        return x[0] + scipy.signal.lfilter(b.ravel(), a, x - x[0])

    found = diagnose(recordings(rides, conditions=(("30", -30.0, 30.0), ("60", -60.0, 60.0))))
    assert [f.cause for f in found.findings] == ["resonance"]
    parameters = found.findings[0].parameters
    assert parameters["frequency"].value == pytest.approx(95.0, abs=0.1)
    assert parameters["damping"].value == pytest.approx(0.05, rel=0.02)
    assert found.rungs[-1].rms_nm < 1.03 * 2.0  # of noise


def test_a_step_that_leads_astray_is_shortened_until_it_does_not():
    # below the fastest half loop a slew limit does at once what no tangent above it knows of
    space, plain = begun(recordings())
    point = with_member(plain, "slew-limit", {"limit": 20.0}, limit=299.9)
    point = refit(space, point, steps=1).point
    settle(space, point)
    before = space.linear(point)
    there, change, left = _moved(space, point, before, np.array([-20.0]))
    assert -20.0 < change[0] < 0.0
    assert there.model.stage("slew-limit")["limit"] > 280.0
    assert square_of(left) < ASTRAY * square_of(before)


def test_what_predicted_worse_is_looked_at_again():
    first, up, down = object(), object(), object()
    search = SimpleNamespace(
        first=first, steps=[Step("creep", 0.0, up), Step("thermal-drift", 0.0, down)],
        error=lambda k, fitted: {id(first): 9.0, id(up): 2.0, id(down): 2.001}[id(fitted)],
    )  # fmt: skip
    assert _gained_nothing(search) == ["thermal-drift"]


@pytest.mark.study
def test_with_a_hum_the_first_ladder_only_goes_up(monkeypatch):
    whole = sys.modules["piezo_rig.diagnosis.in_turns"]
    seen = []

    def climbed(*given, brief=False):
        seen.append(brief)
        return known(*given, brief=brief)

    def creeps(x, drive, t):
        return x + sum(5e-3 * (relaxation(x, tau) - x[0]) for tau in np.geomspace(0.01, 100, 9))

    def hums(x, t, rng):
        return x + 2e-3 * np.sin(2.0 * np.pi * (50.0 * t + rng.uniform()))

    known = whole.climbed
    monkeypatch.setattr(whole, "climbed", climbed)
    found = diagnose(recordings(creeps, sensor=hums, conditions=CONDITIONS[1:]))
    assert seen == [True, False]
    assert {f.cause for f in found.findings} == {"mains-hum", "creep"}
    assert not found.unexplained.detected


class Ladder:
    """What a ladder predicts: errors of its last rung, and without a table."""

    noise_nm, fitted = 2.0, "with"

    def __init__(self, **errors):
        self.errors = errors

    def error(self, k, fitted):
        return self.errors[fitted]


@pytest.mark.parametrize(("without", "with_it", "unknown_nm", "left_over", "only_stands_in"), [
    (2.5, 2.02, 0.0, True, False),  # there is nothing left
    (3.03, 2.45, 0.0, True, True),  # a law of another form: it leaves 1.4 nm and took 1.8
    (3.03, 2.45, 0.0, False, False),  # what it leaves is noise that the fit has followed
    (30.0, 3.0, 0.0, True, False),  # it leaves 2.2 nm, but took 30
    (2.02, 2.0, 0.35, True, True),  # took 0.28 nm, and 0.35 that nobody has a name for is left
    (2.2, 2.0, 0.35, True, False),  # took 0.9
])  # fmt: skip
def test_a_table_that_leaves_as_much_as_it_takes_stands_in_for_something(
    without, with_it, unknown_nm, left_over, only_stands_in
):
    search = Ladder(**{"with": with_it, "less": without})
    assert _stands_in(search, "less", unknown_nm, left_over) == only_stands_in


@pytest.mark.study
def test_a_last_descent_that_predicts_worse_is_not_taken(monkeypatch):
    def astray(space, fitted):
        stage = fitted.point.model.stage("creep")
        moved = stage.with_values(rate_per_decade=0.5 * stage["rate_per_decade"])
        point = replace(fitted.point, model=fitted.point.model.with_stage(moved))
        return replace(fitted, point=point)

    def creeps(x, drive, t):
        return x + sum(5e-3 * (relaxation(x, tau) - x[0]) for tau in np.geomspace(0.01, 100, 9))

    monkeypatch.setattr("piezo_rig.diagnosis.climbed.converged", astray)
    found = diagnose(recordings(creeps, conditions=CONDITIONS[1:]))
    assert [f.cause for f in found.findings] == ["creep"]
    assert found.rungs[-1].rms_nm < 1.05 * 2.0
