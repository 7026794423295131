"""A mode that the whole displacement rides on, among samples of which there are few to its period.

Long recordings are scored on averages of several samples. What the base model does there rings as
well, however few of them there are to a period.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import TransferFunction, lsim

from piezo_rig.causes import CAUSES
from piezo_rig.chain.stage import Signal
from piezo_rig.diagnosis import diagnose
from piezo_rig.run_file.sweep import Sweep
from tests.diagnosis.sliders import play

RATE, FREQUENCY, DAMPING, NOISE_UM = 5000.0, 275.0, 0.06, 1.8e-3


def rung(moved: np.ndarray, time: np.ndarray) -> np.ndarray:
    """What rides on the mode, driven by straight lines between the samples."""
    omega = 2.0 * np.pi * FREQUENCY
    mode = TransferFunction([omega**2], [1.0, 2.0 * DAMPING * omega, omega**2])
    return np.asarray(lsim(mode, moved - moved[0], time)[1] + moved[0])


@pytest.mark.parametrize("periods", [0.1, 0.4, 0.6])
def test_changes_of_the_base_ring_at_every_distance_of_samples(periods):
    time = np.arange(400) * periods / FREQUENCY
    change = np.clip(np.arange(400.0) - 100.0, 0.0, 7.0)
    stage = CAUSES["resonance"].of(
        None, share=1.0, frequency=FREQUENCY, damping=DAMPING, moves_along=0.0
    )
    carried = stage.carry(Signal(time, change, change), change[None, :])[0]
    assert np.ptp(carried) > 1.01 * np.ptp(change)
    assert carried == pytest.approx(rung(change, time), abs=0.03)


def holding(seed: int) -> np.ndarray:
    """Fast ramps between levels, and holds, on whole samples."""
    rng, volts, at = np.random.default_rng(seed), [np.zeros(500)], 0.0
    for _ in range(24):
        to = float(rng.uniform(0.0, 70.0))
        n = max(20, round(abs(to - at) / 2000.0 * RATE))
        volts += [np.linspace(at, to, n + 1)[1:], np.full(int(rng.integers(300, 900)), to)]
        at = to
    return np.concatenate([*volts, np.linspace(at, 0.0, 200), np.zeros(100)])


def test_a_mode_behind_a_bent_drive_is_named_alone_and_sized():
    sweeps = list[Sweep]()
    for number in range(6):
        volts = holding(number % 3)
        time, rng = np.arange(volts.size) / RATE, np.random.default_rng(100 + number)
        bent = volts + 0.06 * volts * (1.0 - volts / 70.0)
        moved = rung(play(bent, np.linspace(0.5, 36.0, 72), 0.0012), time)
        seen = moved - moved[0] + NOISE_UM * rng.standard_normal(volts.size)
        sweeps.append(Sweep(
            f"sweep_{number + 1:04d}", volts, seen, RATE, 1.0, 0.0, 1.0, 1, 0.0,
            f"drive {number % 3}", number // 3 + 1, "virgin", 30.0 * number, "IMPORTED",
        ))  # fmt: skip
    found = diagnose(sweeps)
    assert [f.cause for f in found.findings] == ["resonance"]
    assert not found.unexplained.detected
    said = found.findings[0].parameters
    assert said["damping"].value == pytest.approx(DAMPING, rel=0.01)
    assert said["share"].value == pytest.approx(1.0, abs=0.01)
    assert found.rungs[-1].rms_nm < 1.1 * found.noise_floor_nm
