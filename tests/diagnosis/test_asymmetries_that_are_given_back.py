"""Asymmetries that loops close at their own ends, on the random Prandtl body of the small bench.

Half loops begin steeper one way than the other. What they gain so over some volts is given back
evenly on the way to where the half loop before began, be that near or far. Written out here.
"""

from __future__ import annotations

import sys
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from small_bench import recordings

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.early import credited
from piezo_rig.diagnosis.early.clean_up import Early
from piezo_rig.diagnosis.events import Event

RISES = tuple((f"0-{top:g}", 0.0, top) for top in (35.0, 50.0, 75.0))


def given_back(x, drive, t, over_v, share):
    """``share`` of the mean slope over ``over_v``, on every half loop but the first."""
    out, sign = x.copy(), np.sign(np.diff(drive))
    turns = [0, *(np.flatnonzero(sign[1:] * sign[:-1] < 0) + 1), drive.size - 1]
    slope, whole = np.ptp(x) / np.ptp(drive), None
    for begin, end in pairwise(turns):
        v = np.abs(drive[begin : end + 1] - drive[begin])
        if whole is not None:
            back = np.clip((whole - v) / (whole - over_v), 0.0, 1.0)
            out[begin : end + 1] = x[begin : end + 1] + share * slope * np.minimum(v, over_v) * back
        whole = v[-1]
    return out


@pytest.mark.study
@pytest.mark.parametrize(("over_v", "share", "seed"), [
    pytest.param(5.0, 0.04, 0, marks=pytest.mark.study), (8.0, -0.03, 3),
])  # fmt: skip
def test_it_is_named_alone_and_most_of_it_explained(over_v, share, seed):
    effect = partial(given_back, over_v=over_v, share=share)
    found = diagnose(recordings(effect, conditions=RISES, seed=seed))
    assert [f.cause for f in found.findings] == ["direction-asymmetry"]
    ratio = found.findings[0].parameters["ratio"].value  # of V/um
    assert (ratio - 1.0) * share < 0.0
    assert found.findings[0].gain_percent > 50.0


def test_more_losses_are_better_and_then_fewer_outliers():
    def early(cause, *sizes):
        events = tuple(
            Event(1, "s", "c", 1, "r", 9, 0.1, (0.1, 0.1), size, "1", (0, 0, 9)) for size in sizes
        )
        return Early(cause, 1e-9, {}, None, events)

    lost, spikes = early("dropped-samples", 3.0, 2.0), early("outliers", 20.0, -9.0)
    assert credited([lost]) > credited([lost, spikes]) > credited([spikes])
    assert credited([]) > credited([spikes])
