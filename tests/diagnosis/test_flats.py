"""Where a sensor ends, recordings that age are alike: those edges are no losses and no jumps."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.causes import named_model
from piezo_rig.diagnosis.alike import of_one_history, plainly_apart
from piezo_rig.diagnosis.early.breaks import find_breaks
from piezo_rig.diagnosis.early.mended import DROP
from piezo_rig.diagnosis.engine import plain_space
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.flats import standing
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.masks import runs
from piezo_rig.diagnosis.refit import refit
from piezo_rig.identification import prepare
from tests.diagnosis.small_bench import RATE, recordings

END_UM = 8.6  # of 9.3 over 75 V
TRIANGLES = (("0-50", 0.0, 50.0), ("0-75", 0.0, 75.0))
SESSION_S = 32.737  # from one recording to the next


def ageing(lost=(), end_um=END_UM, kind="ar", repeats=3, per_decade=0.01):
    """Recordings that go further every time; of the last some samples are lost."""
    def sensor(x, t, rng):
        x = x * (1.0 + per_decade * np.log10(1.0 + t / SESSION_S))
        x = np.minimum(x, end_um)
        if lost and t[0] > (2 * repeats - 1) * SESSION_S:
            (at, count), = lost
            x = np.append(np.delete(x, slice(at, at + count)), np.repeat(x[-1], count))
        return x

    sweeps = recordings(sensor=sensor, kind=kind, repeats=repeats, conditions=TRIANGLES)
    return sweeps, group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)


def breaks_in(sweeps, groups):
    point = Point(starting_model(groups, named_model("classical"), "classical"))
    model = refit(plain_space(groups, point.model), point).point.model
    return find_breaks(groups, model, sweeps, 1e-4).breaks


@pytest.mark.parametrize(("kind", "end_um"), [("white", 9.0), ("ar", END_UM)])
def test_what_ages_beneath_a_sensors_end_has_lost_nothing(kind, end_um):
    assert breaks_in(*ageing(kind=kind, end_um=end_um)) == ()


def test_a_loss_beside_it_is_found_all_the_same():
    at, count = round(0.7 * RATE), 6
    (found,) = breaks_in(*ageing(lost=((at, count),), per_decade=0.004))
    assert found.cause == DROP
    assert (found.index, found.count) == (pytest.approx(at, abs=3), count)


def test_it_stands_from_where_it_ends_until_the_displacement_comes_back():
    _, groups = ageing()
    high = max(groups.groups, key=lambda g: np.ptp(g.drive_v))
    inside = high.measured_um.mean(axis=0) > END_UM - 0.02
    flat = standing(high)
    assert np.all(flat[inside])
    assert np.count_nonzero(flat & ~inside) <= 3 * 2 * 5  # a few samples on both sides of each top
    assert len(runs(flat)) == 3  # one in every cycle
    low = min(groups.groups, key=lambda g: np.ptp(g.drive_v))
    assert not standing(low).any()


@pytest.mark.parametrize("kind", ["white", "ar", "1/f"])
def test_a_turn_of_the_drive_is_no_end(kind):
    _, groups = ageing(end_um=np.inf, kind=kind)
    assert not any(standing(g).any() for g in groups.groups)


def plain_ageing(end_um):
    _, groups = ageing(end_um=end_um)
    point = Point(starting_model(groups, named_model("classical"), "classical"))
    model = refit(plain_space(groups, point.model), point).point.model
    return groups, plainly_apart(groups, model)


def test_how_fast_an_actuator_ages_does_not_hang_on_where_its_sensor_ends():
    (_, freely), (groups, ended) = (plain_ageing(end) for end in (np.inf, END_UM))
    rates = [model.stage("cycle-aging")["rate_per_decade"] for model in (freely, ended)]
    assert rates[1] == pytest.approx(rates[0], rel=0.05)
    alike = of_one_history(groups, ended)
    for g, same in zip(groups.groups, alike.groups, strict=True):
        flat = standing(g)
        assert np.array_equal(same.measured_um[:, flat], g.measured_um[:, flat])
        apart = [np.ptp(x.measured_um[:, ~flat].mean(axis=1)) for x in (g, same)]
        assert apart[1] < 0.5 * apart[0]  # and all else is more nearly as if of one age
