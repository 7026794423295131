"""One recording alone, in noise that is the larger the slower it is.

Without repeats the spectrum comes from what a generous model leaves, and that has followed the
slowest noise.
"""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.noise import Spectrum
from piezo_rig.run_file.sweep import Sweep
from tests.diagnosis.sliders import play

RATE, NOISE_UM = 5000.0, 3e-3


def pink(samples: int, seed: int) -> np.ndarray:
    """Noise of a power that falls with the frequency, part of a record four times as long."""
    white = np.random.default_rng(seed).standard_normal(4 * samples)
    frequency = np.fft.rfftfreq(white.size)
    frequency[0] = frequency[1]
    cut = np.fft.irfft(np.fft.rfft(white) / np.sqrt(frequency))[:samples]
    return NOISE_UM * cut / cut.std()


def decaying() -> np.ndarray:
    """Triangles of 5 Hz, two of each of a dozen amplitudes from 70 V down."""
    time = np.arange(int(24 * RATE / 5.0)) / RATE
    saw = 1.0 - np.abs(2.0 * ((5.0 * time) % 1.0) - 1.0)
    return 70.0 * (1.0 - np.floor(2.5 * time) / 12.0) * saw


def alone(added) -> Sweep:
    """A virgin recording of it, with something added to what springs and sliders make of it."""
    volts = decaying()
    time = np.arange(volts.size) / RATE
    moved = play(volts, np.linspace(0.5, 36.0, 72), 0.003) + added(time)
    return Sweep(
        "sweep_0001", volts, moved - moved[0], RATE, 1.0, 0.0, 1.0, 1, 0.0, "", 1, "virgin", 0.0,
        "IMPORTED",
    )  # fmt: skip


@pytest.mark.study
@pytest.mark.parametrize("seed", range(6, 12))
def test_slow_noise_is_neither_a_drift_nor_unexplained(seed):
    found = diagnose([alone(lambda t: pink(t.size, seed))])
    assert [f.cause for f in found.findings] == []
    assert not found.unexplained.detected
    assert found.unexplained.p_value > 0.005


@pytest.mark.study
def test_a_drift_in_white_noise_is_still_found():
    def drift(time):
        return 4e-3 * time + NOISE_UM * np.random.default_rng(5).standard_normal(time.size)

    found = diagnose([alone(drift)])
    assert [f.cause for f in found.findings] == ["thermal-drift"]
    assert found.findings[0].parameters["rate"].value == pytest.approx(4.0, rel=0.1)


CORNERS = np.geomspace(1e-4, 0.5, 16)


@pytest.mark.parametrize("slope", [0.0, -1.0])
def test_a_spectrum_goes_on_as_it_comes(slope):
    """What is read at the hidden corners is nothing; those above them know the power law."""
    log_power = slope * np.log(CORNERS)
    read = Spectrum(CORNERS, np.where(np.arange(16) < 5, -30.0, log_power), np.full(16, 0.1))
    onward = read.onward(5)
    assert onward.log_power == pytest.approx(log_power, abs=1e-9)
    assert np.all(np.diff(onward.error[:5]) < 0.0)
    assert onward.error[4] > 0.1 > 0.99 * onward.error[5]


def test_noise_does_not_fall_towards_low_frequencies():
    read = Spectrum(CORNERS, np.log(CORNERS), np.full(16, 0.1))
    assert np.ptp(read.onward(5).log_power[:5]) == 0.0


def test_a_spectrum_that_hides_nothing_stays_as_it_is():
    read = Spectrum(CORNERS, np.log(CORNERS), np.full(16, 0.1))
    assert read.onward(0) is read
