"""An amplifier that saturates, in one sweep of equal triangles: which end of the drive it is at.

The base has followed what it could of it at both.
"""

from dataclasses import replace

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.put_in import _nearest
from piezo_rig.diagnosis.refit import refit
from tests.diagnosis.sliders import play, recorded
from tests.diagnosis.spaces import begun

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


@pytest.mark.parametrize(("limits", "tried"), [
    ((-100.0, 52.7), [{"upper": v} for v in (47.0, 50.0, 54.0, 58.0)]),
    ((12.4, 100.0), [{"lower": v} for v in (7.0, 10.0, 15.0, 20.0)]),
])  # fmt: skip
def test_a_level_is_looked_for_between_those_that_were_tried(limits, tried):
    """Volts beside it a large one is worth nothing, and no descent leads there."""
    space, plain = begun(triangles(limits))
    kind = CAUSES["drive-clipping"]
    points = [
        replace(plain, model=plain.model.with_stage(kind.of(None, **{**kind.neutral, **t})))
        for t in tried
    ]  # fmt: skip
    stage = _nearest(space, refit(space, plain), points, kind.id).model.stage(kind.id)
    (name,) = tried[0]
    assert stage[name] == pytest.approx(min(limits, key=abs), abs=0.2)
    (other,) = {"upper", "lower"} - {name}
    assert stage[other] == kind.neutral[other]
