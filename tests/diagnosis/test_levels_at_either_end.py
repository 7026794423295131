"""An amplifier that saturates, in one sweep of equal triangles: which end of the drive it is at.

The base has followed what it could of it at both.
"""

import numpy as np
import pytest

from piezo_rig.diagnosis import diagnose
from tests.diagnosis.sliders import play, recorded

RATE, LOW_V, HIGH_V = 2000.0, 5.0, 61.0


def triangles(limits):
    """Eight of 2 Hz, behind one to 75 V that nobody recorded."""
    up = np.linspace(0.0, 1.0, 500, endpoint=False)
    drive = LOW_V + (HIGH_V - LOW_V) * np.tile(np.concatenate([up, 1.0 - up]), 8)
    before = 75.0 * np.concatenate([up, 1.0 - up, up[: round(500 * LOW_V / 75.0)]])
    sliders = np.geomspace(0.4, 36.0, 40)
    x = play(np.concatenate([before, np.clip(drive, *limits)]), sliders, 0.002)[before.size :]
    noise = 0.002 * np.random.default_rng(7).standard_normal(drive.size)
    return [recorded(drive, x - x[0] + noise, RATE, "unknown")]


@pytest.mark.parametrize(("name", "limits"), [
    *(("upper", (-100.0, v)) for v in (50.0, 54.0, 55.3, 57.0)), ("lower", (11.7, 100.0)),
])  # fmt: skip
@pytest.mark.study
def test_a_limit_is_found_where_it_is(name, limits):
    found = diagnose(triangles(limits))
    assert [f.cause for f in found.findings] == ["drive-clipping"]
    values = found.findings[0].parameters
    assert set(values) == {name}
    assert values[name].value == pytest.approx(max(limits[0], 0) or limits[1], abs=0.02)
    assert not found.unexplained.detected
