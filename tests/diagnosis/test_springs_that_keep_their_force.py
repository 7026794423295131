"""Laws of a first spring that keeps its force over turning points, hidden in recordings.

The plant moves springs and sliders from one that gives way to the next, each with a force of its
own; the program follows the displacement and knows no such events.
"""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.held_springs import forms_of
from piezo_rig.run_file import Sweep

RATE, HZ, HALF_UM = 1000.0, 2.0, 0.28
AT_V_PER_UM = 0.5  # the force at which a slider gives way, by that displacement
DRIVES = {
    "to 75 V": [0.0, *[75.0, 0.0] * 5],
    "to 50 V": [0.0, *[50.0, 0.0] * 5],
    "to 25 V": [0.0, *[25.0, 0.0] * 5],
    "decaying": [0.0, 75.0, 5.0, 68.0, 12.0, 60.0, 20.0, 50.0, 28.0, 42.0, 33.0, 37.0, 0.0],
    "walk": [0.0, 40.0, 25.0, 70.0, 30.0, 45.0, 10.0, 55.0, 0.0, 65.0, 50.0, 60.0, 0.0],
}


def slid(turns_v, law, at_force):
    """Where the actuator is when the drive is where: volts and um of every event, loop by loop.

    ``law`` : stiffness of one spring more, by half loop, counted from 1, and turning points
    """
    rng, x, loops = np.random.default_rng(8), 0.0, []
    limits = np.sort(rng.uniform(0.05, 5.0, 40))
    springs = rng.uniform(0.5, 1.5, 40) * 0.05
    k = np.concatenate([[0.0], springs, [6.0]])
    far = np.concatenate([[HALF_UM], limits, [99.0]])
    force = np.zeros(k.size)
    for m in range(1, len(turns_v)):
        k[0] = law(m, turns_v)
        most = k * far
        if at_force:
            most[0] = AT_V_PER_UM * HALF_UM
        way, volts = np.sign(turns_v[m] - turns_v[m - 1]), turns_v[m - 1]
        left, events = abs(turns_v[m] - volts), [(volts, x)]
        while left > 1e-12:
            room = most - way * force
            moving = room > 1e-12
            stiff = float(k[moving].sum())
            step = min(left / stiff, float(np.min(room[moving] / np.maximum(k[moving], 1e-12))))
            force[moving] += way * step * k[moving]
            x, volts, left = x + way * step, volts + way * step * stiff, left - step * stiff
            events.append((volts, x))
        loops.append(np.array(events))
    return loops


def recordings(law, at_force, seed):
    rng, out = np.random.default_rng(seed), []
    for name, turns in DRIVES.items():
        drive, moved = [np.zeros(1)], [np.zeros(1)]
        for (a, b), events in zip(pairwise(turns), slid(turns, law, at_force), strict=True):
            volts = np.linspace(a, b, round(RATE / HZ / 2.0) + 1)[1:]
            order = np.argsort(events[:, 0])
            drive.append(volts)
            moved.append(np.interp(volts, events[order, 0], events[order, 1]))
        v, x = np.concatenate(drive), np.concatenate(moved)
        out.append(Sweep(
            f"sweep_{len(out) + 1:04d}", v, x + 2e-3 * rng.standard_normal(v.size), RATE, 1.0, 0.0,
            1.0, 1, 0.0, name, 1, "virgin", 60.0 * len(out), "SIMULATED",
        ))  # fmt: skip
    return out


def of_range(m, turns_v):
    return 0.05 + 0.006 * (abs(turns_v[m - 1] - turns_v[m - 2]) if m > 1 else 0.0)


def of_extremum(m, turns_v):
    return 0.1 + 0.006 * turns_v[m - 1]


def of_both(m, turns_v):
    return 0.5 + 0.002 * (turns_v[m - 1] if m > 1 else 30.0)


@pytest.mark.parametrize(("cause", "law", "at_force", "slope", "offset"), [
    pytest.param("extremum-dependence", of_extremum, False, 0.006, 0.1, marks=pytest.mark.study),
    pytest.param("range-dependence", of_range, False, 0.006, 0.05, marks=pytest.mark.study),
    pytest.param("extremum-dependence", of_both, True, 0.002, 0.5, marks=pytest.mark.study),
])  # fmt: skip
def test_the_law_is_named_and_nothing_else(cause, law, at_force, slope, offset):
    found = diagnose(recordings(law, at_force, 0))
    assert [f.cause for f in found.findings] == [cause]
    said = found.findings[0].parameters
    assert said["at_force"].value == at_force
    gives_way = 0.5 * said["reach"].value * (said["spring"].value if at_force else 1.0)
    true = HALF_UM * (AT_V_PER_UM if at_force else 1.0)
    assert gives_way == pytest.approx(true, rel=0.25 if at_force else 0.05)  # the table has a part
    for name, true in (("slope", slope), ("offset", offset)):
        low, high = said[name].ci95
        assert low < true < high
    assert not found.unexplained.detected


@pytest.mark.parametrize(("tops_v", "any_form"), [((60.0, 60.0), False), ((60.0, 30.0), True)])
def test_it_is_asked_only_where_the_law_changes_the_spring(tops_v, any_form):
    """Behind equal half loops a law of the range is a spring that stays as it is."""
    groups = [SimpleNamespace(drive_v=np.interp(np.arange(1000), [0, *range(100, 1000, 100)],
                                                [0.0, v, 0.0, v, 0.0, v, 0.0, v, 0.0, v]))
              for v in tops_v]  # fmt: skip
    space = SimpleNamespace(groups=SimpleNamespace(groups=groups, has_first_rise=False))
    law = CAUSES["range-dependence"].of(None, slope=0.01, offset=0.0, reach=0.5, closing=0.0,
                                        taper=0.0)  # fmt: skip
    asked = forms_of(space, law)
    assert bool(asked) == any_form
    assert all(s["spring"] > 0.0 for s in asked)
