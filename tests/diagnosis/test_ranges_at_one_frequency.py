"""Where all triangles have one frequency, half loops that go further are faster.

A first spring that follows the range then looks like a loop that opens with speed. Which of the two
it is shows over the first volts after every turn. Over several frequencies bends of the base may
stand for it.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.scan import Scan
from piezo_rig.run_file import Sweep
from tests.more import first_of

RATE, CYCLES, REPEATS = 2000.0, 4, 3
ONE, SEVERAL = (2.0,), (1.0, 4.0)  # Hz
UP_TO_V = (10, 20, 30, 40, 50, 60, 75)
VOLTS, MEAN_V = 2.5, 35.0  # after a turn, over which the spring holds; of the ranges
NOISE_UM = 4e-3  # of one sample
WHITE, SLOW = 0.0, 0.9  # of the noise, from one sample to the next


def branch(volts):
    """Displacement of a half loop after a turn, um: a body whose loops are those of a power law."""
    return 0.093 * volts + 0.00616 * volts**1.5


def sweeps(um_per_v, seed, speeds=ONE, goes_on=SLOW):
    """Loops from 0 V that were played before; each half loop lags behind the range before it."""
    rng, out = np.random.default_rng(seed), []
    plays = [(r, hz, v) for r in range(1, REPEATS + 1) for hz in speeds for v in UP_TO_V]
    for repeat, hz, high in plays:
        half = round(RATE / hz / 2)
        gone = high * np.arange(half) / half
        lag = um_per_v * (high - MEAN_V) * np.minimum(gone / VOLTS, 1.0)
        full = um_per_v * (high - MEAN_V)
        up = branch(gone) - lag
        down = branch(high) - full - (branch(gone) - lag)
        drive = np.tile(np.concatenate([gone, high - gone]), CYCLES)
        white = rng.standard_normal(drive.size + 200) * np.sqrt(1.0 - goes_on**2)
        noise = lfilter([1.0], [1.0, -goes_on], white)[200:]
        x = np.tile(np.concatenate([up, down]), CYCLES) + NOISE_UM * noise
        out.append(Sweep(
            f"sweep_{len(out) + 1:04d}", drive, x, RATE, 1.0, 0.0, 1.0, 1, 0.0,
            f"0-{high}" if len(speeds) == 1 else f"0-{high} at {hz:g} Hz",
            repeat, "unknown", 60.0 * len(out), "IMPORTED",
        ))  # fmt: skip
    return out


A_RATE_BESIDE_IT = pytest.mark.xfail(strict=True, reason="a rate dependence is named as well")
SOFTER_IN_WHITE = pytest.param(-1e-3, 5, ONE, WHITE, marks=[pytest.mark.study, A_RATE_BESIDE_IT])


@pytest.mark.parametrize(
    ("um_per_v", "seed", "speeds", "noise"),
    [*first_of(0, [
        (1e-3, 1, ONE, WHITE),
        (1e-3, 1, ONE, SLOW),
        (6e-4, 3, ONE, SLOW),
        (-6e-4, 2, ONE, SLOW),
        (1e-3, 4, SEVERAL, SLOW),
    ]), SOFTER_IN_WHITE],
)  # fmt: skip
def test_a_steep_spring_that_follows_the_range_is_no_speed(um_per_v, seed, speeds, noise):
    found = diagnose(sweeps(um_per_v, seed, speeds, noise))
    (own,) = found.findings
    assert own.cause == "range-dependence"
    # the stiffer a spring, the further its half loop lags
    assert np.sign(own.parameters["slope"].value) == np.sign(um_per_v)
    assert own.p_value < 1e-6
    assert own.gain_percent > 5.0


def test_its_chance_is_that_of_what_goes_by_speed():
    ids = ("creep", "rate-dependence", "range-dependence", "extremum-dependence")
    said = np.array([0.0, 60.0, 8.0, 8.0])
    found = Scan(ids, said, np.array([0.3, 1e-9, 0.2, 0.4]), said, 0.0 * said, {})
    fast, none = np.array([1]), np.array([], dtype=np.int64)
    assert found.of_their_kind(fast, found.p_family).tolist() == [0.3, 1e-9, 1e-9, 0.4]
    assert found.of_their_kind(none, found.p_family).tolist() == found.p_family.tolist()
