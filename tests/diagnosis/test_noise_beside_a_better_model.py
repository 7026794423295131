"""Without repeats noise is what a generous model leaves: ringing that it lacks is no noise."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_rig.causes import CAUSES
from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.engine import noise_of, plainly
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification import prepare
from tests.diagnosis.sliders import play, recorded

RATE, HZ, DAMPING, NOISE_UM = 20000.0, 412.0, 0.025, 4e-3
LIMITS = np.geomspace(0.5, 36.0, 30)
LEVELS = ((0, 40, 10, 60, 30, 75, 0), (0, 75, 20, 50, 0))


def steps(levels, slew):
    """Holds of 0.1 s between edges."""
    parts = [np.zeros(200)]
    for a, b in itertools.pairwise(levels):
        edge = np.linspace(a, b, round(abs(b - a) / slew * RATE) + 1)
        parts += [edge, np.full(round(0.1 * RATE), float(b))]
    return np.concatenate(parts)


def rung(x):
    """A mode behind the actuator, from its differential equation by the bilinear transform."""
    w = 2.0 * RATE * np.tan(np.pi * HZ / RATE)
    k = 2.0 * RATE
    a = [k * k + 2 * DAMPING * w * k + w * w, 2 * w * w - 2 * k * k,
         k * k - 2 * DAMPING * w * k + w * w]  # fmt: skip
    return lfilter([w * w, 2 * w * w, w * w], a, x - x[0])


def ringing(delay_s=0.0):
    out, rng = [], np.random.default_rng(3)
    for number, (levels, slew) in enumerate(zip(LEVELS, (40000.0, 30000.0), strict=True)):
        drive = steps(levels, slew)
        x = rung(play(drive, LIMITS, 0.0009))
        late = np.arange(x.size) - delay_s * RATE
        x = np.interp(late, np.arange(x.size), x) + NOISE_UM * rng.standard_normal(x.size)
        out.append(recorded(drive, x, RATE, number=number + 1, condition=f"steps {number}"))
    return out


def test_noise_is_what_it_is_once_the_ringing_has_a_name():
    sweeps = ringing()
    groups = group_tracks(prepare(sweeps), sweeps)
    base = plainly(groups, Point(starting_model(groups, (), "classical"))).point
    mode = CAUSES["resonance"].of(None, share=1.0, frequency=HZ, damping=DAMPING)
    better = plainly(groups, Point(base.model.with_stage(mode))).point
    rng = np.random.default_rng(0)
    beside, known = (noise_of(groups, p, rng)[0].samples for p in (base, better))
    assert 1e3 * beside.spectrum.rms_um > 20.0
    assert known.spectrum.rms_um == pytest.approx(NOISE_UM, rel=0.15)


@pytest.mark.study
def test_what_the_ringing_had_hidden_is_found_beside_it():
    found = diagnose(ringing(60e-6))
    assert found.findings[0].cause == "resonance"
    late = {"time-skew", "amplifier-lag"}  # which of them, edges of one speed hardly say
    assert len(found.findings) == 2
    assert found.findings[1].cause in late
    assert found.rungs[-1].rms_nm < 1.1 * 1e3 * NOISE_UM
