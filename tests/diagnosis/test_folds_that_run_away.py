"""What is held out is predicted by a model that fits what it was trained on.

The strain of an actuator of the tests' own is bent, in one long multisine whose history nobody
knows: a bend of the displacement and one of the drive do much the same there, and how much there
is of either the data hardly know.
"""

import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_rig.diagnosis import diagnose
from piezo_rig.run_file.sweep import Sweep
from tests.diagnosis.sliders import play

RATE, SECONDS, NOISE_NM = 2000.0, 16.0, 2.0
FREQUENCIES = (0.5, 1.0, 1.75, 2.75, 4.25)


def bent_multisine(seed: int) -> list[Sweep]:
    rng, t = np.random.default_rng(seed), np.arange(int(SECONDS * RATE)) / RATE
    phases = rng.uniform(0, 6.28, 5)
    v = sum(np.sin(2 * np.pi * f * t + p) for f, p in zip(FREQUENCIES, phases, strict=True))
    v = 2 + 68 * (v - v.min()) / np.ptp(v)
    up = np.linspace(0, 75, 600)
    down = up[::-1][:400]
    before = np.concatenate([up, down, np.linspace(down[-1], v[0], 200)])
    x = play(np.concatenate([before, v]), np.linspace(0.5, 36, 72), 0.0012)
    x = (x * (1 + 0.03 * (1 - x / x.max())))[before.size :]
    sweeps = []
    for k in range(2):
        white = np.random.default_rng(10 * seed + k).standard_normal(v.size + 500)
        noise = 1e-3 * NOISE_NM * np.sqrt(1 - 0.9**2) * lfilter([1], [1, -0.9], white)[500:]
        sweeps.append(Sweep(
            f"sweep_{k + 1:04d}", v, x - x[0] + noise, RATE, 1.0, 0.0, 1.0, 1, 0.0, "a", k + 1,
            "unknown", 30.0 * k, "IMPORTED",
        ))  # fmt: skip
    return sweeps


@pytest.mark.study
@pytest.mark.parametrize("seed", [0, 3])
def test_a_bend_of_which_data_hardly_know_how_large_it_is_leaves_nothing_to_find(seed: int) -> None:
    found = diagnose(bent_multisine(seed))
    assert [f.cause for f in found.findings] == []
    assert not found.unexplained.detected
    assert found.rungs[-1].rms_nm < 1.15 * NOISE_NM
