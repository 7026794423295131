"""A real micromanipulator: identified on a sine, tried on minor loops and holds.

Reference figure: 1.33 % rms of range with play operators at zero delay, offset removed
(the recordings' own README).
"""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.identification import identify
from piezo_rig.run_file import Sweep


def recording(path):
    data = np.genfromtxt(path, delimiter=",", names=True)
    y = data["displacement_um"]
    return Sweep(
        name=path.stem, command_v=data["drive_v"], sensor_v=y, sample_rate=200.0, gain=1.0,
        offset_v=0.0, sensitivity_um_per_v=1.0, polarity=1, zero_v=float(y[0]),
        condition=path.stem, repeat=1, history="unknown", start_time=0.0, origin="IMPORTED",
    )  # fmt: skip


@pytest.mark.shared
def test_a_sine_predicts_minor_loops_and_holds(shared):
    folder = shared / "data" / "micromanipulator"
    sine = recording(folder / "sine_1hz.csv")
    other = recording(folder / "decaying_and_holds.csv")
    found = identify([sine], "classical")
    predicted = found.model.simulate(other.time_s, other.drive_v, history="unknown")
    error = (other.displacement_um - predicted)[200:]
    error -= error.mean()
    rms = np.sqrt(np.mean(error**2)) / np.ptp(other.displacement_um)
    assert 100 * rms <= 1.33
