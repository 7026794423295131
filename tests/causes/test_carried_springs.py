"""A first spring that keeps its force over turning points, against springs and sliders with forces.

The sliders here are moved step by step, each with a force of its own; the program follows branches.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.chain import Elements, Maxwell, Model

K, X = np.array([4.0, 3.0, 2.0, 5.0]), np.array([0.2, 0.6, 1.5, 99.0])  # V/um, um
TURNS = (0.0, 24.0, 4.0, 20.0, 8.0, 23.0, 2.0, 22.0, 12.0, 21.0, 3.0)  # V
PER_VOLT = 0.03  # of the first spring


def slid(turns, law):
    """Displacement at the turning points, um; ``law`` (range, extremum): more of the first spring.

    A spring that becomes another one at a turning point keeps its force.
    """
    force, k, x, out = np.zeros(K.size), K.copy(), 0.0, [0.0]
    for m in range(1, len(turns)):
        if m > 1:
            k[0] = K[0] + law(abs(turns[m - 1] - turns[m - 2]), turns[m - 1])
        way, left = np.sign(turns[m] - turns[m - 1]), abs(turns[m] - turns[m - 1])
        while left > 1e-12:
            room = k * X - way * force
            moving = room > 1e-12
            stiff = float(k[moving].sum())
            step = min(left / stiff, float(np.min(room[moving] / k[moving])))
            force[moving] += way * step * k[moving]
            x += way * step
            left -= step * stiff
        out.append(x)
    return np.array(out)


def played(turns, stage=None):
    points = 200
    drive = np.concatenate([turns[:1], *(
        np.linspace(a, b, points + 1)[1:] for a, b in pairwise(turns)
    )])  # fmt: skip
    model = Model((Maxwell.of(Elements(K, X)),))
    model = model if stage is None else model.with_stage(stage)
    return model.simulate(np.arange(drive.size) / 1e3, drive)[::points]


def test_both_are_the_same_without_a_law():
    assert played(TURNS) == pytest.approx(slid(TURNS, lambda *_: 0.0), abs=1e-9)


@pytest.mark.parametrize(("cause", "law"), [
    ("range-dependence", lambda range_v, _: PER_VOLT * range_v),
    ("extremum-dependence", lambda _, extremum_v: PER_VOLT * extremum_v),
])
def test_half_loops_go_as_far_as_those_of_sliders_with_forces(cause, law):
    def further(**form):
        stage = CAUSES[cause].of(None, slope=PER_VOLT, reach=2.0 * X[0], offset=0.0, **form)
        return np.diff(played(TURNS, stage))[2:]  # the first one begins where there is no law

    true = np.diff(slid(TURNS, law))[2:]
    plain = np.diff(played(TURNS))[2:]
    off, without = np.abs(further(carries=1.0) - true), np.abs(further(carries=0.0) - true)
    # the same to rounding, but where a half loop goes on beyond the one before it
    assert np.sum(off > 1e-12) <= 2
    assert off.max() < 0.1 * np.abs(plain - true).max()
    assert without.max() > 0.1 * np.abs(plain - true).max()


@pytest.mark.parametrize(("cause", "law"), [
    ("range-dependence", lambda range_v, _: PER_VOLT * range_v),
    ("extremum-dependence", lambda _, extremum_v: PER_VOLT * extremum_v),
])
def test_with_a_spring_of_its_own_all_half_loops_go_as_far_as_they_do(cause, law):
    """However much the law changes it: here by up to a fifth."""
    stage = CAUSES[cause].of(
        None, slope=PER_VOLT, reach=2.0 * X[0], offset=K[0], carries=1.0, spring=K[0],
        at_force=0.0, from_rest=0.0,
    )  # fmt: skip
    true, plain = np.diff(slid(TURNS, law)), np.diff(played(TURNS))
    off = np.abs(np.diff(played(TURNS, stage)) - true)
    assert off.max() < 0.01 * np.abs(plain - true).max()


def test_over_loops_that_begin_at_one_voltage_one_of_the_extremum_is_one_of_the_range():
    """Mean of top and bottom, which is half the range: the same model, at half the slope."""
    turns = (0.0, 24.0, 0.0, 24.0, 0.0, 12.0, 0.0, 12.0, 0.0)
    extremum = CAUSES["extremum-dependence"].of(
        None, slope=PER_VOLT, reach=2.0 * X[0], offset=0.0, carries=1.0
    )
    of_range = CAUSES["range-dependence"].of(
        None, slope=0.5 * PER_VOLT, reach=2.0 * X[0], offset=0.0
    )
    two, one = (np.diff(played(turns, s)) for s in (extremum, of_range))
    settled = [k for k in range(1, 8) if k != 5]  # a range is of the half loop before
    assert two[settled] == pytest.approx(one[settled], abs=1e-9)
    assert np.abs(two - np.diff(played(turns))).max() > 0.01


def test_so_it_leaves_open_whatever_one_of_the_range_does():
    """With less left open it would win over a law of the range that does the same."""
    kinds = CAUSES["extremum-dependence"], CAUSES["range-dependence"]
    numbers = {"slope": PER_VOLT, "reach": 2.0 * X[0], "offset": 0.0}
    extremum, of_range = (kind.of(None, **numbers, carries=1.0) for kind in kinds)
    for depends in ("range", "direction"):
        assert extremum.assumed[depends] >= of_range.assumed[depends] > 0.0
    for kind in kinds:
        assert kind.of(None, **numbers).assumed == kind.law
        assert kind.of(None, **numbers, carries=0.0).assumed == kind.law
