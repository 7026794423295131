"""What goes by speed is told apart only by more than what remains unexplained."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_rig.diagnosis.refit import refit
from piezo_rig.diagnosis.unlike import within_what_remains
from tests.diagnosis.small_bench import RATE, recordings
from tests.diagnosis.spaces import begun, with_member

TAU_S = 4e-3


def late(drive):
    """The drive behind a first-order lag, straight between samples, from where it begins."""
    keeps = np.exp(-1.0 / (RATE * TAU_S))
    ramp = (1.0 - keeps) * RATE * TAU_S
    return drive[0] + lfilter([1.0 - ramp, ramp - keeps], [1.0, -keeps], drive - drive[0])


@pytest.fixture(scope="module")
def fitted():
    """The lag, fitted beside the base model."""
    space, plain = begun(recordings(before=late))
    lag = with_member(plain, "amplifier-lag", {"tau": 1e-4}, tau=TAU_S)
    return space, refit(space, lag)


def test_a_lag_is_a_lag_where_nothing_remains(fitted):
    assert within_what_remains(*fitted, "amplifier-lag", 1e-5) == []


def test_it_may_be_a_delay_where_more_remains_than_the_two_differ_by(fitted):
    assert "time-skew" in within_what_remains(*fitted, "amplifier-lag", 1.0)


def test_nothing_is_asked_of_what_does_not_go_by_speed(fitted):
    assert within_what_remains(*fitted, "creep", 1.0) == []
