"""Creep goes on from one recording to the next: what is left of it is taken off, where it is there.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter
from spaces import begun, with_member

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.left_creeping import left_before, less_what_creeps_on
from piezo_rig.diagnosis.refit import refit
from piezo_rig.run_file import Sweep

RATE, RATE_PER_DECADE, REST_S = 1000.0, 0.003, 1.5
TOPS = (30.0, 45.0, 60.0, 75.0)


def lag(x, tau):
    """First order, from its first value on."""
    k = 1.0 - np.exp(-1.0 / RATE / tau)
    return x[0] + lfilter([k], [1.0, k - 1.0], x - x[0])


def triangles(top, cycles=3, half=250):
    up = np.linspace(0.0, top, half + 1)
    return np.append(np.tile(np.concatenate([up[:-1], up[:0:-1]]), cycles), 0.0)


def sitting(anew, seed=0):
    """Triangles to four voltages twice, with rests of 1.5 s at 0 V between them; the actuator's
    memory is gone after each, its creep only with ``anew``.
    """
    drives = [triangles(top) for top in TOPS] * 2
    rest = np.zeros(round(REST_S * RATE))
    whole, at = [], []
    rng = np.random.default_rng(seed)
    thresholds = np.sort(rng.uniform(0.3, 36.0, 60))
    for drive in drives:
        states, x = np.zeros(thresholds.size), np.empty(drive.size)
        for i, v in enumerate(drive):
            states = np.clip(states, v - thresholds, v + thresholds)
            x[i] = 0.09 * v + 4e-4 * states.sum()
        at.append(sum(map(len, whole)))
        whole += [x, x[-1] + rest]
    stretches = [np.concatenate(whole)] if not anew else whole[::2]
    crept = [x + RATE_PER_DECADE / 4.0 * sum(lag(x, tau) for tau in np.logspace(-2, 3, 21))
             for x in stretches]  # fmt: skip
    sweeps = []
    for k, drive in enumerate(drives):
        x = crept[k] if anew else crept[0][at[k] : at[k] + drive.size]
        shown = -(x + 1e-3 * rng.standard_normal(x.size)) / 15.48
        sweeps.append(Sweep(
            name=f"s{k}", command_v=(drive - 75.0) / 7.5, sensor_v=shown, sample_rate=RATE,
            gain=7.5, offset_v=75.0, sensitivity_um_per_v=15.48, polarity=-1, zero_v=shown[0],
            condition=f"{TOPS[k % 4]:g}", repeat=1 + k // 4, history="virgin",
            start_time=at[k] / RATE, origin="IMPORTED",
        ))  # fmt: skip
    return sweeps


def fitted(sweeps):
    space, plain = begun(sweeps)
    creeping = with_member(plain, "creep", {"rate_per_decade": 1e-3}, rate_per_decade=1e-3)
    return refit(space, creeping, held=True)


def rate(fitted):
    return fitted.point.model.stage("creep")["rate_per_decade"]


def test_a_rate_that_is_too_low_for_it_is_right_without_it():
    before = fitted(sitting(anew=False))
    found = less_what_creeps_on(before, before.space.groups)
    assert rate(before) < 0.95 * RATE_PER_DECADE
    assert found.fitted.evidence > before.evidence + 3.0
    assert abs(rate(found.fitted) / RATE_PER_DECADE - 1.0) < 0.7 * (
        1.0 - rate(before) / RATE_PER_DECADE
    )


def test_where_every_recording_begins_settled_nothing_is_taken_off():
    before = fitted(sitting(anew=True))
    assert less_what_creeps_on(before, before.space.groups) is None


@pytest.mark.study
def test_a_whole_diagnosis_finds_the_rate_in_its_interval():
    found = diagnose(sitting(anew=False))
    assert [f.cause for f in found.findings] == ["creep"]
    low, high = found.findings[0].parameters["rate_per_decade"].ci95
    assert low < RATE_PER_DECADE < high
    assert any("goes on from one recording to the next" in note for note in found.notes)
    assert not found.unexplained.detected


def recorded(*rows, start_s=(0.0,), drive=(0.0, 0.0)):
    time = np.arange(len(rows[0])) / RATE
    volts = np.linspace(*drive, time.size)
    return SimpleNamespace(
        time_s=time, drive_v=volts, measured_um=np.array(rows, float), repeats=len(rows),
        starts_s=np.array(start_s), sweeps=tuple((k,) for k in range(len(rows))),
    )  # fmt: skip


def of(*groups):
    return SimpleNamespace(groups=groups, rate=RATE, span_v=60.0)


def test_what_a_pulse_leaves_dies_away_until_the_next_recording():
    pulse = np.concatenate([[0.0], np.ones(2000), np.zeros(500)])  # 2 s, then half a second
    times = np.array([0.3, 4.0])
    first, second = left_before(of(
        recorded(pulse, pulse, start_s=(0.0, 4.0)), recorded(pulse, start_s=(10.0,))
    ), times)  # fmt: skip
    one = -np.expm1(-2.0 / times) * np.exp(-0.5 / times)
    assert np.allclose(first[0], 0.0)
    assert np.allclose(first[1], one * np.exp(-1.5 / times), rtol=3e-3)
    both = (first[1] * np.exp(-2.5 / times) + one) * np.exp(-3.5 / times)
    assert np.allclose(second[0], both, rtol=3e-3)


@pytest.mark.parametrize("groups", [
    of(recorded(np.zeros(100))),  # one recording
    of(recorded(np.zeros(1000)), recorded(np.zeros(1000), start_s=(0.5,))),  # both at a time
    of(recorded(np.zeros(100)), recorded(np.zeros(100), start_s=(5.0,), drive=(30.0, 30.0))),
])  # fmt: skip
def test_nobody_knows_what_was_before(groups):
    assert left_before(groups, np.array([0.3, 4.0])) is None


def test_recordings_of_the_same_drives_are_fitted_by_the_same_columns():
    space, plain = begun(sitting(False))
    refit(space, plain)
    other, _ = begun(sitting(True))
    there = space.with_measured(other.groups)
    assert there.fixed[0] is space.fixed[0]
    before, kept, own = (
        s.together.predicted(refit(s, plain).point.model) for s in (space, there, other)
    )
    assert kept == pytest.approx(own, abs=1e-5)
    assert np.max(np.abs(kept - before)) > 1e-3
