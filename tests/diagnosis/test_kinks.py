"""Break points that the data ask for: where sliders give way, and nowhere else."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from sliders import play, recorded
from spaces import begun

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.climbed import Climbed
from piezo_rig.diagnosis.kinks import as_in, with_kinks
from piezo_rig.diagnosis.refit import refit, square_of

RATE, NOISE_UM = 2000.0, 1e-3
FEW = np.array([2.3, 6.1, 9.7, 14.2, 19.9, 27.1])  # V; of a table's 80 places none is at one
MANY = np.linspace(0.3, 36.0, 120)


TOPS = (30.0, 50.0, 62.0, 75.0)


def sweeps(limits, share, more=lambda seen: seen, seed=0, tops=TOPS):
    """Triangles of some heights, twice each."""
    rng, out = np.random.default_rng(seed), []
    for repeat in (1, 2):
        for top in tops:
            up = np.linspace(0.0, top, 400)
            drive = np.tile(np.concatenate([up[:-1], up[:0:-1]]), 3)
            seen = more(play(drive, limits, share)) + NOISE_UM * rng.standard_normal(drive.size)
            out.append(recorded(
                drive, seen, RATE, number=len(out) + 1, condition=f"0-{top:g}", repeat=repeat,
            ))  # fmt: skip
    return out


def fitted_to(recordings):
    space, point = begun(recordings)
    return space, refit(space, point)


def nearest(places, to):
    """How far off the nearest of some places is, of each."""
    return np.abs(np.asarray(to)[:, None] - np.asarray(places)).min(axis=1)


def table_of(point):
    (table,) = point.tables
    return table.elements.knots_v


def test_a_band_is_halved_where_a_slider_gives_way_and_nowhere_else():
    space, first = fitted_to(sweeps(FEW, 0.03))
    before, after = table_of(first.point), table_of(with_kinks(space, first))
    width = np.diff(before, prepend=0.0)[np.searchsorted(before, FEW)]
    assert (nearest(after, FEW) < 0.15 * width).all()
    new = after[nearest(before, after) > 1e-6]
    bands, of = np.searchsorted(before, new), np.searchsorted(before, FEW)
    assert nearest(of, bands).max() <= 1  # where a band ends, the one beside it helps


def test_what_is_left_is_noise_then():
    space, first = fitted_to(sweeps(FEW, 0.03))
    there = refit(space, with_kinks(space, first))
    count = float(first.linear.count.sum())
    noise = 1e-3 * space.noise_nm / np.sqrt(2.0)  # of a mean of two
    before, after = (np.sqrt(square_of(f.linear) / count) for f in (first, there))
    assert before > 1.5 * noise
    assert after == pytest.approx(noise, rel=0.1)


@pytest.mark.parametrize("more", [
    lambda seen: seen,
    lambda seen: seen + 5e-3 * np.sin(seen),  # which no element does
])  # fmt: skip
def test_a_smooth_actuator_keeps_its_even_places(more):
    space, first = fitted_to(sweeps(MANY, 0.0005, more))
    assert with_kinks(space, first) is None


def test_where_much_else_is_amiss_causes_come_first():
    space, first = fitted_to(sweeps(FEW, 0.03, lambda seen: seen + 0.05 * np.sin(seen)))
    assert with_kinks(space, first) is None


@pytest.mark.study
def test_the_baseline_of_a_diagnosis_has_them():
    found = diagnose(sweeps(FEW, 0.03))
    assert found.findings == []
    assert found.rungs[0].rms_nm < 1.1e3 * NOISE_UM


def drifting(seen):
    return seen + 40e-3 * np.arange(seen.size) / RATE


@pytest.mark.study
def test_they_are_looked_for_beside_the_first_cause_as_well():
    found = diagnose(sweeps(FEW, 0.03, drifting, tops=TOPS[2:]))
    assert [f.cause for f in found.findings] == ["thermal-drift"]
    assert found.findings[0].parameters["rate"].value == pytest.approx(40.0, abs=1.0)
    assert found.rungs[-1].rms_nm < 1.1e3 * NOISE_UM


def test_a_table_with_more_break_points_is_the_same_curve():
    space, first = fitted_to(sweeps(FEW, 0.03))
    other = with_kinks(space, first)
    there = as_in(first.point, other)
    assert table_of(there) == pytest.approx(table_of(other))
    for group in space.groups.groups:
        expected = group.predicted(first.point.model)
        assert group.predicted(there.model) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("worse", [False, True])
def test_they_are_kept_where_they_predict_better(worse, monkeypatch):
    space, first = fitted_to(sweeps(FEW, 0.03))
    out = Climbed(space, "sweep", "sweep", None, True, first, "sweep")
    there = with_kinks(space, first)
    if worse:
        monkeypatch.setattr(Climbed, "error_nm", lambda self, fitted: fitted.point.compliances)
    assert out.predicting_better(there, first, first) is (None if worse else there)
    assert out.predicting_better(None, first, first) is None
