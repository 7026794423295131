"""Recordings whose scored part begins late, and ladders without a rung."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from piezo_rig.diagnosis.climb import Search
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification import prepare
from piezo_rig.run_file.sweep import Sweep
from tests.diagnosis.sliders import play

RATE = 1000.0


def late() -> list[Sweep]:
    """Two recordings of unknown history that see both their extremes late, one of them later."""
    out, time = [], np.arange(16000) / RATE
    for number, share in ((1, 0.2), (2, 0.4)):
        small = np.where(time < share * time[-1], 0.4, 1.0)
        volts = 35.0 + 30.0 * small * np.sin(2 * np.pi * 1.1 * time + 1.0)
        moved = play(volts, np.linspace(0.5, 30.0, 20), 0.002)
        out.append(Sweep(f"sweep_{number:04d}", volts, moved, RATE, 1.0, 0.0, 1.0, 1, 0.0, "", 1,
                         "unknown", 60.0 * number, "IMPORTED"))  # fmt: skip
    return out


def test_the_beginning_of_a_recording_has_something_that_is_scored():
    sweeps = late()
    groups = group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)
    assert min(g.blocks[0][0] for g in groups.groups) > 2000
    for group in groups.whole(3000).groups:
        ((begin, end),) = group.blocks
        assert 500 < end - begin <= 1501
        inside = (group.loops.start >= begin) & (group.loops.stop <= end)
        assert np.count_nonzero(inside) >= 2


def test_a_ladder_whose_only_rung_was_dropped_has_none():
    search = Search(SimpleNamespace(), SimpleNamespace(), np.random.default_rng(0), print, [], 1.0,
                    0, lambda *_: True, rearranged=True)  # fmt: skip
    assert search.rungs() == []
