"""Hidden effects in data of an independent bench: found, named, sized; silence where none is."""

from __future__ import annotations

import re
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from small_bench import CONDITIONS, RATE, recordings, relaxation

from piezo_rig.diagnosis import diagnose, document, text
from piezo_rig.errors import InputError
from tests.more import first_of


def names(found):
    return [f.cause for f in found.findings]


def holds(parameter, true):
    low, high = parameter.ci95
    # twice the interval: one recording in twenty may lie outside of it
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    return abs(true - middle) < 2.0 * half


@pytest.mark.parametrize("kind", first_of(1, ["ar", "1/f", "white"]))
def test_an_actuator_off_the_grid_in_coloured_noise_is_no_finding(kind):
    found = diagnose(recordings(kind=kind, seed=3))
    assert names(found) == []
    assert not found.unexplained.detected
    assert found.follow_up is None


def creep(rate):
    times = np.logspace(-2, 3, 11)
    weights = np.full(11, rate / 2)
    weights[[0, -1]] /= 2
    return lambda x, drive, t: x + sum(
        w * relaxation(x, tau) for w, tau in zip(weights, times, strict=True)
    )


@pytest.mark.study
def test_creep_is_found_sized_and_worth_its_gain():
    found = diagnose(recordings(creep(0.01)))
    assert names(found) == ["creep"]
    finding = found.findings[0]
    assert holds(finding.parameters["rate_per_decade"], 0.01)
    assert finding.gain_percent > 50
    assert found.rungs[-1].rms_nm < 1.6 * found.noise_floor_nm


def test_without_repeats_creep_is_found_and_the_noise_floor_is_not_known():
    found = diagnose(recordings(creep(0.012), repeats=1, conditions=CONDITIONS[:1]))
    assert "creep" in names(found)
    assert found.noise_floor_nm is None
    assert any("no repeats" in n for n in found.notes)


@pytest.mark.study
def test_a_first_rise_of_its_own_is_an_initiation_stage():
    def effect(x, drive, t):
        largest = np.maximum.accumulate(np.abs(drive - drive[0]))
        return x - 0.3 * (1 - np.exp(-((largest / 40.0) ** 2)))

    found = diagnose(recordings(effect))
    assert names(found)[0] == "initiation-stage"


@pytest.mark.study
def test_a_record_that_lags_is_a_skew_or_something_listed_with_it():
    delay = 5e-4

    def effect(x, drive, t):
        return np.interp(t - delay, t, x)

    found = diagnose(recordings(effect))
    finding = found.findings[0]
    assert "time-skew" in [finding.cause, *finding.alternatives]
    size = next(iter(finding.parameters.values()))
    if finding.cause in ("time-skew", "amplifier-lag"):
        assert size.value == pytest.approx(delay, rel=0.2)
    if finding.alternatives:
        assert found.follow_up is not None


@pytest.mark.study
def test_drift_is_found_with_its_rate():
    found = diagnose(recordings(lambda x, drive, t: x + 20e-3 * t))
    assert names(found)[:1] == ["thermal-drift"]
    assert holds(found.findings[0].parameters["rate"], 20.0)


@pytest.mark.study
def test_a_drift_that_settles_is_found_with_its_rate_at_the_beginning_of_the_session():
    def warming(x, t, rng):  # the session begins at 10 s and lasts four time constants
        return x + 30e-3 * 60.0 * (1.0 - np.exp(-(t - 10.0) / 60.0))

    found = diagnose(recordings(sensor=warming))
    assert names(found) == ["thermal-drift"]
    assert holds(found.findings[0].parameters["rate"], 30.0)
    assert holds(found.findings[0].parameters["settling"], 1.0 / 60.0)
    assert found.noise_floor_nm == pytest.approx(2.0, rel=0.05)
    assert found.rungs[-1].rms_nm < 2.2


@pytest.mark.study
def test_a_ripple_over_displacement_is_the_interferometers():
    def sensor(x, t, rng):
        return x + 4e-3 * np.sin(2 * np.pi * x / 0.3164 + 0.4)

    found = diagnose(recordings(sensor=sensor))
    assert names(found) == ["periodic-nonlinearity"]
    assert holds(found.findings[0].parameters["amplitude"], 4.0)


def test_hum_and_spikes_are_found_in_clock_time():
    def sensor(x, t, rng):
        x = x + 3e-3 * np.sin(2 * np.pi * 50.0 * t + 0.3)
        spikes = rng.random(x.size) < 2.0 / RATE
        return x + spikes * 0.3 * rng.choice([-1.0, 1.0], x.size)

    found = diagnose(recordings(sensor=sensor))
    assert names(found) == ["outliers", "mains-hum"]
    outliers, hum = found.findings
    assert outliers.gain_percent is None
    assert hum.parameters["frequency"].value == pytest.approx(50.0, abs=0.1)
    assert hum.parameters["amplitude"].value == pytest.approx(3.0, rel=0.1)


def test_a_baseline_off_by_one_step_of_the_switch_is_refused():
    sweeps = recordings(repeats=1)
    model = diagnose(sweeps).model
    wrong = [s.with_(sensitivity_um_per_v=15.48 * 4, zero_v=s.zero_v) for s in sweeps]
    with pytest.raises(InputError, match="times what the baseline"):
        diagnose(wrong, model)


@pytest.mark.study
def test_the_same_data_give_the_same_answer_in_the_contracts_form():
    sweeps = recordings(creep(0.01), conditions=(("0-30", 0, 30.0), ("0-75", 0, 75.0)))
    found = diagnose(sweeps)
    first = document(found)
    assert first == document(diagnose(sweeps))
    assert first["schema"] == "piezo-rig/diagnosis/1"
    assert {"data", "baseline", "noise_floor_nm", "findings", "extended", "unexplained",
            "follow_up"} <= set(first)  # fmt: skip
    assert first["data"]["held_out"] == "sweep"
    assert text(found)


def test_a_repeat_may_lack_its_last_samples():
    sweeps = recordings(seed=2)
    short = sweeps[5]
    sweeps[5] = short.with_(command_v=short.command_v[:-1], sensor_v=short.sensor_v[:-1])
    found = diagnose(sweeps)
    assert found.findings == []
    assert found.repeats == 2


def humped(x, drive, t):
    """Falling half loops that rise in their middle: nothing in the catalogue does."""
    out, way = x.copy(), np.sign(np.diff(drive, prepend=drive[0]))
    ends = [0, *np.flatnonzero(np.diff(way) != 0), drive.size - 1]
    for a, b in pairwise(ends):
        if b - a > 4 and drive[b] < drive[a]:
            along = np.linspace(0.0, np.pi, b - a + 1)
            out[a : b + 1] += 2e-4 * (drive[a] - drive[b]) * np.sin(along) ** 2
    return out


@pytest.mark.study
def test_beside_something_unknown_stands_only_what_helps_to_predict():
    found = diagnose(recordings(humped, seed=5))
    assert found.unexplained.detected
    # an initiation stage, a delay or a lag gain a little by it; none says what comes next
    assert found.findings == []


@pytest.mark.study
@pytest.mark.xfail(strict=True, reason="a bend of the base says less of conditions left out")
def test_beside_something_unknown_conditions_that_are_left_out_are_predicted_better():
    """3.52 nm with the baseline, 3.81 with the bend that it is given: see decision 54."""
    found = diagnose(recordings(humped, seed=5))
    (note,) = [n for n in found.notes if "left out of the fit" in n]
    baseline, everything = (float(w) for w in re.findall(r"([\d.]+) nm", note))
    assert everything < baseline
