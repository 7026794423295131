"""What goes by speed is told apart only by more than what remains unexplained."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.unlike import within_what_remains
from tests.diagnosis.small_bench import RATE, recordings

TAU_S = 4e-3


def late(drive):
    """The drive behind a first-order lag, from where it begins."""
    keeps = np.exp(-1.0 / (RATE * TAU_S))
    return drive[0] + lfilter([1.0 - keeps], [1.0, -keeps], drive - drive[0])


@pytest.fixture(scope="module")
def found():
    return diagnose(recordings(before=late))


def test_a_lag_is_a_lag_where_nothing_remains(found):
    (finding,) = found.findings
    assert finding.cause == "amplifier-lag"
    assert not found.unexplained.detected
    space, last = found.workings.space, found.workings.last
    assert within_what_remains(space, last, "amplifier-lag", 1e-5) == []


def test_it_may_be_a_delay_where_more_remains_than_the_two_differ_by(found):
    space, last = found.workings.space, found.workings.last
    assert "time-skew" in within_what_remains(space, last, "amplifier-lag", 1.0)


def test_nothing_is_asked_of_what_does_not_go_by_speed(found):
    assert within_what_remains(found.workings.space, found.workings.last, "creep", 1.0) == []
