"""Data that no stack gives are said to be odd, and named after what they look like."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.diagnosis.checks import data_warnings
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification import prepare
from tests.diagnosis.two_drives import session


def said(change=lambda sweep: sweep):
    sweeps = [change(s) for s in session(0, "white", lambda number, time: 0.0 * time)]
    data = prepare(sweeps, clipped=True)
    return data_warnings(group_tracks(data, sweeps), sweeps)


def test_a_stack_as_it_is_gives_no_warning():
    assert said() == []


def test_channels_that_are_swapped_lead():
    def swapped(s):
        return s.with_(command_v=s.sensor_v + 0.5, sensor_v=s.command_v.copy())

    assert any("leads the drive" in warning and "swapped" in warning for warning in said(swapped))


@pytest.mark.parametrize("polarity", [1, -1])
def test_a_sensor_of_the_other_polarity_does_not_lead(polarity):
    def turned(s):
        return s.with_(sensor_v=polarity * s.sensor_v, polarity=polarity)

    assert said(turned) == []


@pytest.mark.parametrize("factor", [1e3, 1e-6])
def test_a_travel_in_another_unit_is_seen(factor):
    assert "um per volt" in said(lambda s: s.with_(sensor_v=factor * s.sensor_v))[0]


def test_a_drive_that_was_recorded_late_leads():
    late = 60  # ms; the loop is worth about ten

    def shifted(s):
        return s.with_(sensor_v=s.sensor_v[late:].copy(), command_v=s.command_v[:-late].copy())

    assert any("recorded late" in warning for warning in said(shifted))


def at_an_end(shift_v, end_v):
    """Recordings that begin at voltages of their own, cut off at one voltage before the noise."""
    rng, number = np.random.default_rng(0), iter(range(100))

    def cut_off(s):
        volts = np.minimum(s.sensor_v + shift_v * next(number), end_v)
        volts += 2e-3 * rng.standard_normal(volts.size)
        return s.with_(sensor_v=volts, zero_v=float(volts[0]))

    return [warning for warning in said(cut_off) if "sensor stands" in warning]


def test_a_voltage_beyond_which_no_recording_goes_is_the_sensors_end():
    (warning,) = at_an_end(shift_v=0.5, end_v=7.0)  # of a travel of 8.2 V and 5 V
    assert "stands at 7.0" in warning
    assert "its highest" in warning
    assert at_an_end(shift_v=0.5, end_v=np.inf) == []  # each goes as far as it likes
    assert at_an_end(shift_v=0.0, end_v=7.0) == []  # all begin at one voltage: a level, and a cause
