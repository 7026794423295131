"""The noise that errors are compared with: of samples, as errors are, and not of averages."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.diagnosis.engine import noise_of, plain_space, space_of
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.refit import refit
from piezo_rig.identification import prepare
from tests.diagnosis.two_drives import session
from tests.more import first_of


@pytest.mark.parametrize("recordings", first_of(1, [2, 6]))
def test_it_is_the_same_with_repeats_and_without(recordings):
    sweeps = session(3, "white", lambda *_: 0.0, 16000)[:recordings]
    groups = group_tracks(prepare(sweeps), sweeps)
    point = Point(starting_model(groups, (), "classical"))
    start = refit(plain_space(groups, point.model), point).point
    whitener, repeated = noise_of(groups, start, np.random.default_rng(0))
    space, _ = space_of(groups, whitener, start.model)
    assert groups.factor > 1
    assert repeated == (recordings > 2)
    assert space.sample_noise_nm == pytest.approx(2.0, rel=0.15)
