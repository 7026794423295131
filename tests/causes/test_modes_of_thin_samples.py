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

FREQUENCY, DAMPING = 275.0, 0.06


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
