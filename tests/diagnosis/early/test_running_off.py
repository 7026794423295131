"""A clock that runs off is no loss halfway through every recording, and such a loss is no clock."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.causes import named_model
from piezo_rig.diagnosis import engine
from piezo_rig.diagnosis.early.clean_up import _believed
from piezo_rig.diagnosis.early.mended import DROP, Break
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification import prepare
from tests.diagnosis.sliders import play, recorded
from tests.more import first_of

RATE, SECONDS, NOISE_UM = 5000.0, 4.4, 1.5e-3
HIGHS = (26.0, 41.0, 60.0, 75.0)
LIMITS = np.linspace(0.4, 30.0, 60)
PPM, LOST, CYCLES = -500.0, 6, 3.0


def triangles(t, high):
    return high * (1.0 - np.abs(2.0 * ((CYCLES / SECONDS * t) % 1.0) - 1.0))


def believed(displace):
    """How many samples are believed to be lost, of so many in the middle of every recording."""
    rng, sweeps = np.random.default_rng(11), []
    t = np.arange(round(RATE * SECONDS)) / RATE
    for k, high in enumerate(HIGHS):
        moved = displace(t, high)
        seen = moved - moved[0] + NOISE_UM * rng.standard_normal(t.size)
        sweeps.append(recorded(triangles(t, high), seen, RATE, "unknown", k + 1))
    data = group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)
    plain = Point(starting_model(data, named_model("classical"), "classical"))
    middle = t.size // 2
    losses = [Break(DROP, k, 0, middle, LOST, middle, middle, t.size, 1e-9)
              for k in range(len(data.groups))]  # fmt: skip
    kept = _believed(
        data, engine.plainly(data, plain).point, losses,
        lambda groups, point: engine.plainly(groups, point).point,
    )  # fmt: skip
    return [b.count for b in kept.breaks]


def used(drive):
    """Displacement of an actuator that has been driven before."""
    up = np.linspace(0.0, 75.0, 2000)
    return play(np.concatenate([up, up[::-1], drive]), LIMITS, 9e-4)[2 * up.size :]


def by_another_clock(t, high):
    return used(triangles(t / (1.0 + 1e-6 * PPM), high))


def with_a_loss(t, high):
    longer = np.arange(t.size + LOST) / RATE
    moved = used(triangles(longer, high))
    return np.delete(moved, np.arange(t.size // 2, t.size // 2 + LOST))


@pytest.mark.parametrize(("displace", "lost"), first_of(1, [
    (with_a_loss, [LOST] * len(HIGHS)), (by_another_clock, []),
]))  # fmt: skip
def test_a_clock_is_no_loss_in_the_middle_and_a_loss_there_is_no_clock(displace, lost):
    assert believed(displace) == lost
