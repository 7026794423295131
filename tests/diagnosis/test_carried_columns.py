"""Small changes of a displacement, as stages behind the actuator show them.

What a stage does to them goes by where the actuator stands; before an unknown history that is not
where the recording is at zero.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from piezo_rig.causes.output_bend import OutputBend
from piezo_rig.causes.periodic_nonlinearity import PeriodicNonlinearity
from piezo_rig.chain import Elements, Maxwell, Model, Reads
from piezo_rig.chain.stage import Signal
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


@pytest.mark.parametrize("history", ["virgin", "unknown"])
def test_an_error_over_displacement_makes_no_ripple_of_what_large_columns_differ_by(history):
    """Columns of a smooth density are um, and what they differ by is nm."""
    drive = 30.0 * (1.0 - np.cos(np.linspace(0.0, 6.0 * np.pi, 900)))
    time = np.arange(drive.size) / 1000.0
    group = SimpleNamespace(time_s=time, drive_v=drive, history=history, reads=None, played=None)
    ripple = PeriodicNonlinearity.of(None, sine=0.8, cosine=-0.6, sine_2=0.2, cosine_2=0.1)
    model = body(COMPLIANCE).with_stage(ripple)
    large = drive * np.linspace(9.0, 11.0, 5)[:, None] + drive**2 * np.arange(5)[:, None]
    apart = np.array([1.0, -4.0, 6.0, -4.0, 1.0])  # of which nothing of either is left
    carried = through(model, group, large)
    assert np.max(np.abs(carried - large)) > 1.0  # it is no small thing
    assert apart @ carried == pytest.approx(np.zeros(drive.size), abs=1e-9)


@pytest.mark.parametrize("scale_um", [None, 5.3, np.nan])
def test_where_a_recording_stands_on_the_scale_is_known_by_its_mean_or_its_beginning(scale_um):
    drive = 30.0 * (1.0 - np.cos(np.linspace(0.0, 6.0 * np.pi, 900)))
    time = np.arange(drive.size) / 1000.0
    reads = None if scale_um is None else (Reads(0.1, 0.8, scale_um),)
    ripple = PeriodicNonlinearity.of(None, sine=0.8, cosine=-0.6, sine_2=0.2, cosine_2=0.1)
    at, by = 0.1 * drive, 1e-6 * np.sin(drive / 7.0)
    before, after = (
        ripple.act(Signal(time, drive, x, reads=None if reads is None else (reads,)))
        for x in (at, at + by)
    )
    signal = Signal(time, drive, at, reads=None if reads is None else (reads,))
    (carried,) = ripple.carry(signal, by[None])
    shown = after.displacement_um - before.displacement_um
    assert carried == pytest.approx(shown, abs=1e-4 * np.max(np.abs(shown)))
