"""By how much the form of a law may be off is a share of what it does within a half loop.

An asymmetry that is not given back gains on every turn: over many turns that is a drift, far
larger than the law's own part of a half loop, of whose form it says nothing.
"""

from __future__ import annotations

import numpy as np
import pytest
from spaces import begun, with_member

from piezo_rig.diagnosis.refit import changed_um, laws_of, settle
from piezo_rig.run_file import Sweep

RATE, HALF = 1000.0, 125


def walked(cycles):
    """Two sweeps of a Prandtl body over so many triangles of 60 V, 2 nm of noise."""
    up = np.linspace(0.0, 60.0, HALF + 1)
    drive = np.append(np.tile(np.concatenate([up[:-1], up[:0:-1]]), cycles), 0.0)
    thresholds = np.linspace(1.0, 29.0, 15)
    states, x = np.zeros(15), np.empty(drive.size)
    for i, v in enumerate(drive):
        states = np.clip(states, v - thresholds, v + thresholds)
        x[i] = 0.09 * v + 3e-3 * states.sum()
    rng = np.random.default_rng(0)
    return [
        Sweep(name=f"s{k}", command_v=(drive - 75.0) / 7.5, sensor_v=-shown / 15.48,
              sample_rate=RATE, gain=7.5, offset_v=75.0, sensitivity_um_per_v=15.48, polarity=-1,
              zero_v=0.0, condition="0-60", repeat=k, history="virgin", start_time=100.0 * k,
              origin="IMPORTED")
        for k in (1, 2) for shown in [x + 2e-3 * rng.standard_normal(x.size)]
    ]  # fmt: skip


def law_and_sizes(cycles, **values):
    """Variance that an asymmetry leaves open of a column; its rms, whole and since turns, um."""
    space, plain = begun(walked(cycles))
    point = with_member(plain, "direction-asymmetry", {"ratio": 0.01}, **values)
    settle(space, point)
    less = point.model.without("direction-asymmetry")
    sizes = [changed_um(space, less, point.model, since) for since in (False, True)]
    return laws_of(space, point.model)[space.tags.index("direction")], sizes


def test_what_turns_have_added_up_to_leaves_no_more_of_a_form_open():
    few, (drifted, within) = law_and_sizes(3, ratio=1.05, reach=0.3)
    many, (drifted_far, _) = law_and_sizes(24, ratio=1.05, reach=0.3)
    assert drifted_far > 6.0 * drifted  # a line that is eight times as long
    assert drifted_far > 3.0 * within
    assert many < few  # of more half loops the first rise, with more of it, is a smaller part


def test_what_is_given_back_is_as_large_as_it_was():
    found, (whole, _) = law_and_sizes(3, ratio=1.05, reach=0.3, closing=1.0, taper=1.0)
    assert found == pytest.approx((0.15 * whole) ** 2, rel=0.2)
