"""Effects of 400 times the noise: the cause is named, alone, and nothing is left unexplained.

So large, every assumption of a law shows: the even spectrum of creep (three relaxations here), and
what becomes of a loop that is closed exactly.
"""

from __future__ import annotations

import pytest

from piezo_rig.diagnosis import diagnose
from piezo_rig.studies.hidden import draw


@pytest.mark.parametrize(
    ("kind", "seed", "protocol"),
    [("creep", 701, "matrix"), ("range-dependence", 700, "matrix")],
)
def test_a_large_effect_is_named_alone_and_leaves_nothing(kind, seed, protocol):
    case = draw(kind, seed, protocol, "white", 400.0, 2)
    found = diagnose(case.sweeps)
    assert [f.cause for f in found.findings] == [kind]
    assert not found.unexplained.detected
    assert found.rungs[-1].rms_nm < 1.03 * 2.0  # of noise
    for name, true in case.truth.parameters[kind].items():
        if name != "offset":
            low, high = found.findings[0].parameters[name].ci95
            assert low - 0.25 * (high - low) < true < high + 0.25 * (high - low)
