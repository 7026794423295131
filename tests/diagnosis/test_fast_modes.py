"""A mode of a bare stack, which only a fast recording shows."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from piezo_rig.diagnosis import diagnose
from tests.diagnosis.sliders import play, recorded

RATE, CYCLE_HZ, NOISE_UM = 50_000.0, 25.0, 0.002
SLIDERS = np.geomspace(0.4, 36.0, 40)


def ringing(x, frequency, damping):
    """What rides on such a mode, which rests at first; straight between samples."""
    omega = 2.0 * np.pi * frequency
    mode = [omega**2], [1.0, 2.0 * damping * omega, omega**2]
    (above,), below, _ = cont2discrete(mode, 1.0 / RATE, method="foh")
    return lfilter(above, below, x)


@pytest.mark.study
def test_its_frequency_and_damping():
    frequency = 7100.0
    rng, out = np.random.default_rng(3), []
    up = np.linspace(0.0, 1.0, round(0.5 * RATE / CYCLE_HZ), endpoint=False)
    wave = np.append(np.tile(np.concatenate([up, 1.0 - up]), 3), 0.0)
    for k, top in enumerate((75.0, 40.0) * 2):
        seen = ringing(play(top * wave, SLIDERS, 0.002), frequency, 0.03)
        noise = NOISE_UM * rng.standard_normal(wave.size)
        out.append(recorded(top * wave, seen + noise, RATE, "virgin", k, f"0-{top:g}", 1 + k // 2))
    found = diagnose(out)
    assert [f.cause for f in found.findings] == ["resonance"]
    told = found.findings[0].parameters
    assert told["frequency"].value == pytest.approx(frequency, rel=0.01)
    assert told["damping"].value == pytest.approx(0.03, rel=0.25)
    assert not found.unexplained.detected
