"""Small changes of a displacement, as stages behind the actuator show them.

What a stage does to them goes by where the actuator stands; before an unknown history that is not
where the recording is at zero.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from piezo_rig.causes.output_bend import OutputBend
from piezo_rig.chain import Elements, Maxwell, Model
from piezo_rig.diagnosis.dictionary import through

KNOTS = np.array([5.0, 20.0, 40.0, 80.0])
COMPLIANCE = np.array([0.08, 0.1, 0.13, 0.15])


def body(compliance):
    return Model((Maxwell(elements=Elements.from_curve(KNOTS, compliance)),))


@pytest.mark.parametrize("history", ["virgin", "unknown"])
@pytest.mark.parametrize("piece", range(3))
def test_they_are_what_the_simulation_changes_by(history, piece):
    up = np.linspace(0.0, 60.0, 200)
    drive = np.concatenate([up, up[::-1][:120], up[80:], up[::-1]])
    time = np.arange(drive.size) / 1000.0
    group = SimpleNamespace(time_s=time, drive_v=drive, history=history, reads=None, played=None)
    before, after = body(COMPLIANCE), body(COMPLIANCE + 1e-5 * np.eye(KNOTS.size)[piece])
    bend = OutputBend.of(None, square=-0.004, cube=0.0001)
    shown = after.with_stage(bend).simulate(time, drive, history)
    shown -= before.with_stage(bend).simulate(time, drive, history)
    own = after.simulate(time, drive, history, since_virgin=True)
    own -= before.simulate(time, drive, history, since_virgin=True)
    (carried,) = through(before.with_stage(bend), group, own[None])
    assert carried - carried[0] == pytest.approx(shown, abs=1e-3 * np.max(np.abs(shown)))
