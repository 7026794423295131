"""What comes and goes is no loss of samples."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.diagnosis.early.mended import DROP, JUMP, Break
from piezo_rig.diagnosis.early.passing import AT_ONCE_S, SOON_S, lasting
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification import prepare
from tests.diagnosis.small_bench import RATE, recordings
from tests.diagnosis.test_flats import TRIANGLES, breaks_in


class Two:
    repeats = 2


class Groups:
    rate = RATE

    def __init__(self, *groups):
        self.groups = groups


def at(index, row, count=1, cause=DROP, group=0, end=4000):
    return Break(cause, group, row, index, count, index, index, end, 1e-9)


SIZE_UM = 0.05
AGAIN_S = 42.737  # when the second of two recordings begins
AT_ONCE, SOON = round(0.5 * AT_ONCE_S * RATE), round(0.9 * SOON_S * RATE)


@pytest.mark.parametrize(("breaks", "kept"), [
    ([at(100, 0), at(100 + AT_ONCE, 1)], []),  # level again
    ([at(100, 0, 2), at(110, 1), at(130, 1)], []),
    ([at(100, 0), at(100 + AT_ONCE, 1), at(3000, 0)], [2]),  # and one that lasts
    ([at(100, 0), at(100 + SOON, 1)], [0, 1]),  # once, by chance
    ([at(100, 0), at(100 + SOON, 1), at(900, 1), at(900 + SOON, 0)], []),  # but not twice
    ([at(100, 0, 2), at(110, 1)], [0, 1]),  # one sample ahead from there on
    ([at(100, 0), at(110, 0)], [0, 1]),  # both of one recording
    ([at(100, 0), at(3900, 1)], [0, 1]),  # ahead for as long as a loss is
    ([at(100, 0), at(110, 1, end=8000)], [0, 1]),  # of other sweeps
    ([at(100, 0, cause=JUMP), at(110, 1, cause=JUMP)], [0, 1]),
])
def test_losses_that_make_up_for_each_other_before_long_are_none(breaks, kept):
    assert lasting(Groups(Two()), breaks) == [breaks[k] for k in kept]


def test_of_three_recordings_each_is_told_from_the_others():
    class Three:
        repeats = 3

    breaks = [at(100, 0), at(110, 1)]
    assert lasting(Groups(Three()), breaks) == breaks


def test_a_knock_on_the_table_has_lost_no_samples():
    """It rings at 9 Hz in one of two recordings, by what the drive does in two samples."""
    def sensor(x, t, rng):
        since = t - AGAIN_S - 0.9
        return x + np.where(
            since > 0.0, SIZE_UM * np.exp(-since / 0.15) * np.sin(2.0 * np.pi * 9.0 * since), 0.0
        )

    sweeps = recordings(sensor=sensor, conditions=TRIANGLES[1:])
    groups = group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)
    assert breaks_in(sweeps, groups) == ()
