"""An error of the sensor that comes back with displacement is seen, whatever its period."""

from __future__ import annotations

import numpy as np
import pytest

from piezo_rig.causes import named_model
from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.engine import plain_space, plainly, with_a_bend
from piezo_rig.diagnosis.fit import Point, starting_model
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.refit import refit
from piezo_rig.diagnosis.ripples import find_drive_ripple, find_ripple, left_of, set_aside
from piezo_rig.identification import prepare
from piezo_rig.studies.hidden import draw
from tests.diagnosis.sliders import play, recorded
from tests.diagnosis.small_bench import recordings
from tests.more import first_of


def classical(sweeps):
    groups = group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)
    model = Point(starting_model(groups, named_model("classical"), "classical"))
    return groups, refit(plain_space(groups, model.model), model).point


def seen(sweeps):
    """In what a classical model leaves."""
    groups, point = classical(sweeps)
    return find_ripple(groups, point.model)


def grating(period_um, size_um, form=np.sin):
    return lambda x, t, rng: x + size_um * form(2.0 * np.pi * (x + 0.03) / period_um)


@pytest.mark.parametrize("repeats", [1, 2])
@pytest.mark.parametrize("period_um", [0.12, 0.4, 0.57])
def test_a_ripple_of_any_period_is_seen(period_um, repeats):
    found = seen(recordings(sensor=grating(period_um, 3e-3), repeats=repeats))
    assert found.period_um == pytest.approx(period_um, rel=0.02)
    # elements take in the more of it, the fewer periods there are
    assert 0.4 < found.rms_nm / (3.0 / np.sqrt(2.0)) < 1.1
    assert found.p_value < 1e-9


def test_its_overtones_hide_no_ripple():
    """An interpolator that loses counts: a saw tooth, whose second order has half the size."""
    found = seen(recordings(sensor=grating(0.5, 3e-3, lambda a: (a / np.pi) % 2.0 - 1.0)))
    assert found.period_um == pytest.approx(0.5, rel=0.01)


@pytest.mark.study
def test_it_is_set_aside_before_causes_are_looked_for():
    """A drift beside it is found, and nothing else is taken for it."""
    ripple = grating(0.57, 3e-3)
    found = diagnose(recordings(sensor=lambda x, t, rng: ripple(x, t, rng) + 5e-3 * (t - t[0])))
    assert [f.cause for f in found.findings] == ["thermal-drift"]
    low, high = found.findings[0].parameters["rate"].ci95
    assert low < 5.0 < high
    rest = found.unexplained
    assert rest.detected
    assert rest.depends_on == ["displacement"]
    assert "every 570" in rest.text
    assert rest.rms_nm == pytest.approx(3.0 / np.sqrt(2.0), rel=0.05)
    assert [r.added for r in found.rungs] == ["classical", "ripple", "thermal-drift"]
    assert found.rungs[-1].rms_nm < 1.05 * found.noise_floor_nm


def test_the_half_wave_has_a_name():
    """The interferometer's own errors, of the first order and the second, are left to it."""
    for period_um, aside in ((0.3164, False), (0.1582, False), (0.25, True)):
        groups, point = classical(recordings(sensor=grating(period_um, 2e-3)))
        found = set_aside(groups, point, lambda groups, p: plainly(groups, p).point, 1e-3)
        assert (found is not None) == aside


def test_a_period_near_half_a_wavelength_tells_the_scale():
    """A sensitivity that is 2 % too large: every length that is read is, the half wave too."""
    found = seen(recordings(sensor=lambda x, t, rng: 1.02 * grating(0.3164, 3e-3)(x, t, rng)))
    assert found.period_um == pytest.approx(1.02 * 0.3164, rel=0.003)
    assert "316.4 nm" in found.text
    assert "if the sensitivity were 0.98" in found.text


@pytest.mark.parametrize("kind", [
    "null", "creep", "amplifier-lag", "direction-asymmetry",
])  # fmt: skip
@pytest.mark.parametrize("protocol", first_of(1, ["matrix", "holds", "one"]))
def test_what_a_model_gets_wrong_is_no_ripple(kind, protocol):
    assert seen(draw(kind, 4021, protocol, "1/f", 100.0, 2).sweeps) is None


def drive_ripple(sweeps):
    """In what a classical model leaves."""
    groups, point = classical(sweeps)
    return find_drive_ripple(groups, point.model)


@pytest.mark.parametrize("period_v", [2.9, 4.4])
def test_a_converter_whose_steps_are_not_alike_is_seen(period_v):
    """Rising and falling alike, at the same volts: no slider knows of those."""
    found = drive_ripple(recordings(
        effect=lambda x, drive, t: x + 3e-3 * np.sin(2.0 * np.pi * drive / period_v + 0.4)
    ))  # fmt: skip
    assert found.period_v == pytest.approx(period_v, rel=0.02)
    assert 0.4 < found.rms_nm / (3.0 / np.sqrt(2.0)) < 1.1
    assert found.p_value < 1e-9
    assert f"every {found.period_v:.3g} V of the drive" in found.text


def converter(x, drive, t):
    return x + 1e-3 * np.sin(2.0 * np.pi * drive / 4.4 + 0.4)


def aside(groups, point):
    return set_aside(groups, point, lambda groups, p: plainly(groups, p).point, 1e-3)


def test_one_over_the_drive_is_set_aside_beside_a_bend_that_the_base_lacks():
    """The bend leaves forty times as much, with kinks of the elements that make up for it."""
    groups, point = classical(recordings(
        effect=lambda x, drive, t: converter(x, drive, t) + 0.4 * (drive / 75.0) ** 4
    ))  # fmt: skip
    assert aside(groups, point) is None
    found = aside(groups, with_a_bend(groups, point))
    assert found.ripple.over == "drive"
    assert found.ripple.period_v == pytest.approx(4.4, rel=0.02)
    assert found.ripple.rms_nm == pytest.approx(1.0 / np.sqrt(2.0), rel=0.1)
    drive = groups.groups[0].drive_v
    off = (groups.groups[0].measured_um - found.groups.groups[0].measured_um)[0]
    error = converter(0.0, drive, 0.0)
    assert np.std(off - error) < 0.2 * np.std(error)


def test_what_a_base_without_its_bend_leaves_is_none():
    """The case that asked for it: 3.4 nm every 7.3 V, and more of it whenever it is taken off."""
    groups, point = classical(draw("null", 9840, "holds", "1/f", 40.0, 2).sweeps)
    assert find_drive_ripple(groups, point.model) is not None
    assert aside(groups, point) is None
    bent = with_a_bend(groups, point)
    assert left_of(groups, bent.model) < 0.1 * left_of(groups, point.model)
    assert find_drive_ripple(groups, bent.model) is None


@pytest.mark.study
def test_beside_one_over_the_drive_a_drift_is_found_and_nothing_else():
    found = diagnose(recordings(
        effect=converter, sensor=lambda x, t, rng: x + 5e-3 * (t - t[0])
    ))  # fmt: skip
    assert [f.cause for f in found.findings] == ["thermal-drift"]
    assert found.unexplained.detected
    assert found.unexplained.depends_on == ["drive"]
    assert [r.added for r in found.rungs] == ["classical", "ripple", "thermal-drift"]


@pytest.mark.parametrize("kind", first_of(2, [
    "extremum-dependence", "null", "creep", "direction-asymmetry",
]))  # fmt: skip
@pytest.mark.parametrize("protocol", first_of(1, ["matrix", "holds", "rates"]))
def test_what_a_model_gets_wrong_is_no_ripple_of_the_drive(kind, protocol):
    sweeps = draw(kind, 4022, protocol, "white", 100.0, 2).sweeps
    assert drive_ripple(sweeps) is None
    assert aside(*classical(sweeps)) is None


@pytest.mark.parametrize("apart_v", [2.5, 5.0])
def test_thresholds_that_are_evenly_far_apart_make_none(apart_v):
    """Every range is a whole multiple of that: their kinks are at the same volts on both ways."""
    limits = np.arange(apart_v, 40.0, apart_v) / 2.0
    tops, rng, sweeps = (30.0, 50.0, 60.0, 75.0), np.random.default_rng(5), []
    for number, top in enumerate(tops * 2):
        time = np.arange(3000) / 2000.0
        volts = top * (1.0 - np.abs(2.0 * ((2.0 * time) % 1.0) - 1.0))
        seen = play(volts, limits, 0.0016 * 30 / limits.size)
        sweeps.append(recorded(
            volts, seen + 2e-3 * rng.standard_normal(time.size), 2000.0, number=number + 1,
            condition=f"to {top:g} V", repeat=number // len(tops) + 1,
        ))  # fmt: skip
    assert drive_ripple(sweeps) is None
    groups, point = classical(sweeps)
    assert aside(groups, point) is None
    assert aside(groups, with_a_bend(groups, point)) is None
