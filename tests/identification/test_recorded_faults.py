"""Faults of a recording that do not stop a fit are mended or said; a healthy one is let through."""

from __future__ import annotations

import numpy as np
import pytest
from recordings import TOP, classical, sweep

from piezo_rig.errors import InputError
from piezo_rig.identification.data import prepare

DRIVE, Y = classical([0.0, TOP, 0.0, TOP, 0.0], 500)


@pytest.mark.parametrize("size", [1e4, 2.0, -2.0])
def test_a_spike_of_the_drive_is_bridged_and_said(size):
    spiked = DRIVE.copy()
    spiked[777] += size
    bad = sweep(spiked, Y, index=2).with_(source="monday.csv")
    data = prepare([sweep(DRIVE, Y), bad])
    np.testing.assert_allclose(data.tracks[1].drive_v, DRIVE, atol=0.03)
    (said,) = [line for line in data.left_out if "777" in line]
    assert said.startswith("warning: monday.csv: sweep_0002: the drive jumps to")


def test_a_pulse_that_the_actuator_followed_was_played():
    drive, y = DRIVE.copy(), Y.copy()
    drive[777] += 5.0
    y[777] += 5.0 * np.ptp(Y) / TOP
    data = prepare([sweep(drive, y)])
    np.testing.assert_allclose(data.tracks[0].drive_v, drive)
    np.testing.assert_allclose(data.tracks[0].displacement_um, y)


@pytest.mark.parametrize("last", [1006, DRIVE.size], ids=["burst", "jump"])
def test_a_displacement_that_leaps_for_longer_is_said(last):
    y = Y.copy()
    y[1000:last] += 0.4 * np.ptp(Y)
    data = prepare([sweep(DRIVE, y)])
    (said,) = data.left_out
    assert "sweep_0001: the displacement jumps by up to" in said
    assert "sample 1000" in said


@pytest.mark.parametrize("points", [4, 20, 150, 500])
def test_corners_and_steps_of_a_clean_drive_are_neither(points):
    for turns in ([0.0, TOP] * 5, [0.0, TOP, 0.0]):
        drive, y = classical(turns, points)
        assert prepare([sweep(drive, y)]).left_out == []
    drive = np.repeat([0.0, 4.0, 8.0, 4.0, 0.0, 4.0, 8.0, 0.0], points + 20)
    assert prepare([sweep(drive, 0.1 * drive)]).left_out == []


def test_noise_on_the_recorded_drive_does_not_make_a_sensor_look_saturated():
    rng = np.random.default_rng(2)
    for index in range(1, 11):
        noisy = DRIVE + 0.4 * rng.standard_normal(DRIVE.size)
        prepare([sweep(noisy, Y + 0.005 * rng.standard_normal(Y.size), index=index)])
    with pytest.raises(InputError, match="largest value"):
        prepare([sweep(noisy, np.minimum(Y, 0.7 * Y.max()))])


def test_only_channels_that_have_a_calibration_are_compared():
    as_given = sweep(DRIVE, Y, index=2).with_(
        command_v=DRIVE, gain=1.0, offset_v=0.0, details={"as_given_drive": True}
    )
    metres = sweep(DRIVE, Y, index=3).with_(
        sensor_v=Y, sensitivity_um_per_v=1.0, polarity=1, details={"as_given_displacement": True}
    )
    assert len(prepare([sweep(DRIVE, Y), as_given, metres]).tracks) == 3
    assert len(prepare([as_given, sweep(DRIVE, Y)]).tracks) == 2
    with pytest.raises(InputError, match=r"gain is 7\.5 in sweep_0001 and 7\.7 in sweep_0004"):
        prepare([as_given, sweep(DRIVE, Y), sweep(DRIVE, Y, index=4).with_(gain=7.7)])
