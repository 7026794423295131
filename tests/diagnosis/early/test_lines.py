"""A line in clock time is heard wherever a recording lasts long enough to hear it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_rig.causes import named_model
from piezo_rig.chain import Parameter
from piezo_rig.diagnosis.early import Early, find_line, hum_again
from piezo_rig.diagnosis.early.hum import Row, find_hum
from piezo_rig.diagnosis.early.lines import spectrum_of
from piezo_rig.diagnosis.engine import plain_space
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.refit import refit
from piezo_rig.identification import prepare
from piezo_rig.run_file import Sweep
from piezo_rig.studies.hidden import draw
from tests.diagnosis.small_bench import RATE, actuator, recordings
from tests.more import first_of


def heard(kind, protocol, seed=725):
    case = draw(kind, seed, protocol, "white", 60.0, 2)
    data = prepare(case.sweeps, first_rises=True, clipped=True)
    groups = group_tracks(data, case.sweeps)
    return case, find_line(groups, None)


@pytest.mark.parametrize("protocol", ["matrix", "rates"])  # of one length; of 0.4 to 2 s
def test_the_floor_is_heard_beside_recordings_that_are_too_short_for_it(protocol):
    case, line = heard("stranger:seismic", protocol)
    shortest = min(c.drive_v.size / c.rate for c in case.conditions)
    assert protocol == "matrix" or 18.0 / shortest > 37.0
    (effect,) = case.effects
    assert line.p_value < 1e-9
    assert line.frequency == pytest.approx(37.0 + effect.width, abs=0.5)
    # repeats that follow each other at the same phase hide some of it, or show more
    assert 0.4 < line.rms_nm / (1e3 * effect.size / np.sqrt(2.0)) < 1.5


def test_nothing_is_heard_where_nothing_is():
    for protocol, seed in (("matrix", 725), ("rates", 725), ("holds", 4007), ("holds", 4013)):
        assert heard("null", protocol, seed)[1].p_value > 1e-3


@pytest.mark.parametrize("kind", first_of(1, ["null", "mains-hum"]))
def test_a_hum_is_heard_again_beside_a_better_model_or_is_none(kind):
    """What a poor baseline leaves has lines at all harmonics of the drive, 50 Hz among them."""
    case = draw(kind, 31, "rates", "white", 60.0, 2)
    groups = group_tracks(prepare(case.sweeps, first_rises=True, clipped=True), case.sweeps)
    def fitted(groups, point):
        return refit(plain_space(groups, point.model), point).point

    base = fitted(groups, Point(starting_model(groups, named_model("classical"), "classical")))
    model = base.model
    told = {"frequency": Parameter(50.0, "Hz", (49.99, 50.01)),
            "amplitude": Parameter(3.0, "nm", (2.9, 3.1))}  # fmt: skip
    if kind == "mains-hum":
        f = find_hum(groups, model).frequency
        told["frequency"] = Parameter(f, "Hz", (f - 0.01, f + 0.01))
    again = hum_again(groups, Early("mains-hum", 1e-20, told, groups), base, fitted, 2e-3, 24)
    assert (again is None) == (kind == "null")
    if again is not None:
        assert again.groups is not groups
        assert again.parameters["amplitude"].ci95[0] > 0.0


LONGER = (("0-40", 0.0, 40.0, 2.0), ("0-75", 0.0, 75.0, 2.0), ("75-25", 25.0, 75.0, 2.0))


def slow_line(sensor, kind="white", repeats=2, seed=0):
    groups = plain_groups(recordings(
        sensor=sensor, kind=kind, repeats=repeats, seed=seed, conditions=LONGER
    ))  # fmt: skip
    model = Point(starting_model(groups, named_model("classical"), "classical"))
    return find_line(groups, refit(plain_space(groups, model.model), model).point.model)


def plain_groups(sweeps):
    return group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)


@pytest.mark.parametrize("repeats", [1, 2])
def test_a_table_that_swings_a_few_times_in_a_recording_is_heard(repeats):
    """7.3 Hz of 3 nm in recordings of 1.5 s, ten or eleven periods, as loud as the noise."""
    line = slow_line(lambda x, t, rng: x + 3e-3 * np.sin(2.0 * np.pi * 7.3 * t), repeats=repeats)
    assert line.p_value < 1e-9
    assert line.frequency == pytest.approx(7.3, abs=0.35)
    assert 0.5 < line.rms_nm / (3.0 / np.sqrt(2.0)) < 1.5


@pytest.mark.parametrize("kind", first_of(1, ["1/f", "white", "ar"]))
def test_slow_noise_is_no_slow_line(kind):
    for seed in range(3):
        line = slow_line(None, kind, seed=seed)
        assert line is None or line.p_value > 1e-3


@pytest.mark.parametrize("differ", [
    lambda x, t, rng: x * (1.0 + 0.002 * np.log10(1.0 + t[0])),  # ages, by its place in the session
    lambda x, t, rng: x + 2e-3 * (t - t[0]) * np.exp(-t[0] / 100.0),  # a drift that settles
])  # fmt: skip
def test_what_repeats_differ_by_because_of_the_drive_is_no_slow_line(differ):
    line = slow_line(differ)
    assert line is None or line.p_value > 1e-3


def test_a_table_that_swings_hides_no_fan():
    """The slow line is louder, and does not stand alone: beside it the faster one is half of it."""
    def sensor(x, t, rng):
        return x + 8e-3 * np.sin(2.0 * np.pi * 6.1 * t) + 3.5e-3 * np.sin(2.0 * np.pi * 97.3 * t)

    line = slow_line(sensor)
    assert line.frequency == pytest.approx(97.3, abs=0.35)
    assert line.p_value < 1e-9


@pytest.mark.parametrize(("own_hz", "heard"), [(10.0, False), (4.0, True)])
def test_what_repeats_differ_by_at_the_speed_of_their_drive_is_no_line(own_hz, heard):
    """Of eight recordings of 3 s one has a line of 10 Hz, where its own drive is or another's."""
    rng, t = np.random.default_rng(4), np.arange(15000) / 5000.0
    rows = [Row(t, rng.standard_normal(t.size), 0.5, (2.0,), (2.0,)) for _ in range(7)]
    line = rng.standard_normal(t.size) + 2.0 * np.sin(2.0 * np.pi * 10.0 * t)
    rows.append(Row(t, line, 0.5, (own_hz,), (own_hz,)))
    found = spectrum_of(rows, 1000.0)
    near = np.abs(found.f - 10.0) < 0.5
    chance = found.chance[near].min() * found.f.size
    assert (chance < 1e-6) == heard


@pytest.mark.parametrize(("size_um", "heard"), [(4e-3, True), (0.0, False)])
def test_a_line_louder_than_what_the_drive_does_there_is_heard(size_um, heard):
    """Of a sum of sines hysteresis makes lines everywhere: 1.8 nm of it are at 34.1 Hz."""
    t = np.arange(24000) / RATE
    drive = sum(a * np.sin(2.0 * np.pi * f * t) for f, a in ((1.7, 20.0), (4.9, 10.0), (11.3, 6.0)))
    drive = 37.0 * (1.0 + drive / np.abs(drive).max())
    line = size_um * np.sin(2.0 * np.pi * 34.1 * t + 1.0)
    rng = np.random.default_rng(8)
    x = actuator()(drive) + line + lfilter([1.0], [1.0, -0.9], 1.3e-3 * rng.standard_normal(t.size))
    groups = plain_groups([Sweep(
        "sweep_0001", drive, x, RATE, 1.0, 0.0, 1.0, 1, 0.0, "sines", 1, "unknown", 0.0, "IMPORTED",
    )])  # fmt: skip
    model = Point(starting_model(groups, named_model("classical"), "classical"))
    found = find_line(groups, refit(plain_space(groups, model.model), model).point.model)
    assert (found is not None and found.p_value < 1e-9) == heard
    if heard:
        assert found.frequency == pytest.approx(34.1, abs=0.1)
        assert found.rms_nm == pytest.approx(1e3 * size_um / np.sqrt(2.0), rel=0.3)
