"""A body whose scale is bent at its input or at its output is no finding.

The bends are written out here, on the random Prandtl body of the small bench.
"""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from tests.diagnosis.small_bench import CONDITIONS, RATE, recordings, relaxation


def of_the_displacement(x, drive, t):
    """1 % of 10 um in the middle."""
    return x + 0.04 * x * (x / 10.0 - 1.0)


def of_the_drive(drive):
    """1.5 V of 75 in the middle; the ends stay."""
    return drive - 6.0 * (drive / 75.0) * (1.0 - drive / 75.0)


def crept(x, t):
    """One hundredth a decade, from 10 ms to 100 s: eight relaxations, two to the decade."""
    share = 0.01 / 2.0
    return x + share * sum(relaxation(x, tau, RATE) for tau in 10.0 ** np.arange(-2.0, 2.0, 0.5))


def of_the_base(found):
    return [r.added for r in found.rungs[1:] if r.finding is None]


@pytest.mark.study
@pytest.mark.parametrize("way", [
    {"effect": of_the_displacement}, {"before": of_the_drive},
], ids=["displacement", "drive"])  # fmt: skip
@pytest.mark.parametrize("kind", ["white", "ar"])
def test_nothing_is_found_on_a_bent_body(way, kind):
    found = diagnose(recordings(kind=kind, **way))
    assert [f.cause for f in found.findings] == []
    assert not found.unexplained.detected
    bends = of_the_base(found)
    assert bends[-1] == ("output-bend" if "effect" in way else "input-bend")
    assert found.rungs[-1].rms_nm < 1.1 * found.noise_floor_nm


@pytest.mark.study
def test_a_creep_behind_a_bent_scale_is_named_alone_and_sized():
    found = diagnose(recordings(
        lambda x, drive, t: crept(of_the_displacement(x, drive, t), t), conditions=CONDITIONS[1:]
    ))  # fmt: skip
    assert [f.cause for f in found.findings] == ["creep"]
    assert found.findings[0].parameters["rate_per_decade"].value == pytest.approx(0.01, rel=0.03)
    assert "output-bend" in of_the_base(found)
    assert all("bend" not in a for a in found.findings[0].alternatives)


@pytest.mark.study
def test_a_law_of_turning_points_is_no_bend():
    """First slopes that go with the drive at the last turning point, over the first 0.8 um."""

    def lawful(x, drive, t):
        out, turn, added = x.copy(), 0, 0.0
        sign = np.sign(np.diff(drive, prepend=drive[0]))
        for k in range(1, x.size):
            if sign[k] * sign[k - 1] < 0:
                turn = k - 1
            near = abs(x[k] - x[turn]) < 0.8 and turn > 0
            added += (x[k] - x[k - 1]) * (0.02 * (drive[turn] / 75.0 - 0.5) if near else 0.0)
            out[k] = x[k] + added
        return out

    found = diagnose(recordings(lawful))
    assert found.findings[0].cause == "extremum-dependence"
