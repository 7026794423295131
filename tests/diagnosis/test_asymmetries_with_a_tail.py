"""Asymmetries that rise at once and fade slowly, on the random Prandtl body of the small bench.

Half loops begin steeper one way than the other: what they gain is v exp(-(v / v0)^2) of the volts
since the turning point, or v exp(-v / v0), on every half loop or on all but the first rise. It is
written out here.
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

FIRST_SLOPE = 0.09  # um/V, of the small bench's body before any of its thresholds
RISES = tuple((f"0-{top:g}", 0.0, top) for top in (35.0, 50.0, 75.0))
FALLS = tuple((f"75-{low:g}", 75.0, low) for low in (25.0, 45.0))


def bulged(x, drive, t, v0, share, first, power=2.0):
    """Every half loop further up by a share of its mean slope; ``first``, of it on the first."""
    out, sign = x.copy(), np.sign(np.diff(drive))
    turns = [0, *(np.flatnonzero(sign[1:] * sign[:-1] < 0) + 1), drive.size - 1]
    slope = np.ptp(x) / np.ptp(drive)
    for k, (begin, end) in enumerate(pairwise(turns)):
        v = np.abs(drive[begin:end] - drive[begin])
        size = (first if k == 0 else 1.0) * share * slope
        out[begin:end] += size * v * np.exp(-((v / v0) ** power))
    return out


@pytest.mark.study
@pytest.mark.parametrize(("conditions", "v0", "share", "first"), [
    (RISES, 8.0, 0.03, 0.0), (RISES, 8.0, 0.03, 1.0), (RISES + FALLS, 12.0, -0.02, 0.0),
])  # fmt: skip
def test_an_asymmetry_with_a_tail_is_named_alone(conditions, v0, share, first):
    effect = partial(bulged, v0=v0, share=share, first=first)
    found = diagnose(recordings(effect, conditions=conditions))
    assert [f.cause for f in found.findings] == ["direction-asymmetry"]
    ratio = found.findings[0].parameters["ratio"].value  # of V/um
    assert (ratio - 1.0) * share < 0.0
    assert not found.unexplained.detected
    assert found.rungs[-1].rms_nm < 0.6 * found.rungs[0].rms_nm


@pytest.mark.study
@pytest.mark.parametrize("share", [0.05, -0.05])
@pytest.mark.parametrize("power", [1.0, 2.0])
def test_nearly_all_of_a_large_one_is_followed_in_its_size(share, power):
    v0 = 3.0 if power == 1.0 else 8.0
    effect = partial(bulged, v0=v0, share=share, first=0.0, power=power)
    sweeps = recordings(effect, conditions=RISES)
    found = diagnose(sweeps)
    assert [f.cause for f in found.findings] == ["direction-asymmetry"]
    floor, before = found.noise_floor_nm, found.rungs[0].rms_nm
    left, there = found.rungs[-1].rms_nm ** 2 - floor**2, before**2 - floor**2
    assert left < 0.1**2 * there or left < (0.35 * floor) ** 2
    # of slopes where half loops begin; the effect's share is that of their mean slope
    mean = float(np.mean([np.ptp(s.displacement_um) / np.ptp(s.drive_v) for s in sweeps]))
    share *= mean / FIRST_SLOPE
    ratio = found.findings[0].parameters["ratio"].value
    assert ratio == pytest.approx((1.0 - share) / (1.0 + share), abs=0.3 * abs(2.0 * share))
