"""Laws of later branches whose constant part the first rise does not have.

A first rise by the same elements shows how large that part is. The law is written out here, on the
random Prandtl body of the small bench.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from small_bench import recordings

from piezo_rig.causes import CAUSES
from piezo_rig.causes.cause import Context
from piezo_rig.chain import Elements, Maxwell, Model
from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.fit import Point
from piezo_rig.diagnosis.scan import extended

SLOPE, OFFSET, REACH_UM = 0.006, 0.3, 0.4
RISES = tuple((f"0-{top:g}", 0.0, top) for top in (20.0, 35.0, 50.0, 75.0))


def sprung(x, drive, t):
    """A spring of slope x range + offset, V/um, more on every half loop but the first."""
    out, sign = x.copy(), np.sign(np.diff(drive))
    turns = [0, *(np.flatnonzero(sign[1:] * sign[:-1] < 0) + 1), drive.size - 1]
    for before, begin, end in zip(turns, turns[1:], turns[2:], strict=False):
        spring = SLOPE * abs(drive[begin] - drive[before]) + OFFSET
        way = np.abs(x[begin : end + 1] - x[begin])
        volts = np.abs(drive[begin : end + 1] - drive[begin])
        moved = np.interp(volts, volts + spring * np.minimum(way, REACH_UM), way)
        out[begin : end + 1] = out[begin] + np.sign(drive[end] - drive[begin]) * moved
    return out


@pytest.mark.study
def test_a_law_that_the_first_rise_does_not_follow_is_named_alone():
    found = diagnose(recordings(sprung, conditions=RISES))
    assert [f.cause for f in found.findings] == ["range-dependence"]
    own = found.findings[0].parameters
    for name, true in (("slope", SLOPE), ("reach", REACH_UM)):
        low, high = own[name].ci95
        assert low < true < high
    assert found.rungs[-1].rms_nm < 1.02 * 2.0  # of noise
    assert not found.unexplained.detected


def law(**values):
    return CAUSES["range-dependence"].of(None, slope=0.004, reach=0.4, **values)


def context(first_rises, *more):
    table = Elements.from_curve(np.linspace(5.0, 75.0, 12), np.linspace(0.1, 0.15, 12))
    model = Model((Maxwell.of(table), *(CAUSES[c].of(table) for c in more)))
    slews = np.array([300.0])
    return replace(Context(model, 10.0, 75.0, slews, 2e-4, 5.0, 5e3), first_rises=first_rises)


@pytest.mark.parametrize(("first_rises", "more", "offset", "count"), [
    (True, (), 0.0, 1), (False, (), 0.0, 0), (True, ("initiation-stage",), 0.0, 0),
    (True, (), 0.2, 0),
])  # fmt: skip
def test_the_constant_part_is_asked_for_only_where_a_first_rise_shows_it(
    first_rises, more, offset, count
):
    forms = law(offset=offset).also(context(first_rises, *more))
    assert len(forms) == count
    assert all(form["offset"] != 0.0 and form["slope"] == 0.004 for form in forms)


def test_the_constant_part_is_held_once_the_first_rise_has_elements_of_its_own():
    model = context(True).model.with_stage(law(offset=0.3))
    names = ("slope", "reach", "offset")
    sizes = tuple(("range-dependence", name, 0.01) for name in names)
    rise = CAUSES["initiation-stage"].of(model.maxwell.elements)
    candidate = SimpleNamespace(id="initiation-stage", variants=((rise,),))
    reduced = SimpleNamespace(
        trials=np.eye(3)[:, :1], z=np.zeros(3), fine=np.zeros((0, 0)),
        covariance=SimpleNamespace(of=lambda scales: np.zeros((0, 0))),
    )  # fmt: skip
    likelihood = SimpleNamespace(reduced=reduced, best_scales=lambda columns: (0.0, 0.0))
    fitted = SimpleNamespace(point=Point(model, (), sizes))
    point = extended(None, fitted, candidate, [0], likelihood, (rise,))
    assert [name for _, name in point.names] == ["slope", "reach"]
    assert point.model.stage("range-dependence")["offset"] == 0.3
