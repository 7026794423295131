"""Few conditions, each played once: the one that goes further than all others is not left out."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_rig.causes import CAUSES
from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.climb import Search
from piezo_rig.diagnosis.climbed import Climbed
from piezo_rig.diagnosis.held_out import CHUNKS, Errors, _inside, held_out_errors
from piezo_rig.diagnosis.ladder import Step
from piezo_rig.diagnosis.refit import refit
from piezo_rig.diagnosis.spare import idle
from tests.diagnosis.small_bench import recordings
from tests.diagnosis.spaces import begun, with_member

PLAYED = (("0-75", 0.0, 75.0, 2.0), ("0-40", 0.0, 40.0, 2.0), ("0-60", 0.0, 60.0, 2.0))
AMPLITUDE_NM = 2.0


def periodic(x, t, rng):
    """Of an interferometer of 633 nm."""
    return x + 1e-3 * AMPLITUDE_NM * np.sin(2.0 * np.pi * x / 0.3164)


@pytest.fixture(scope="module")
def fitted():
    space, plain = begun(recordings(conditions=PLAYED, repeats=1, sensor=periodic))
    without = refit(space, plain)
    cause = CAUSES["periodic-nonlinearity"]
    sizes = {"sine": 0.1, "cosine": 0.1}
    point = with_member(plain, cause.id, sizes, sine=0.5, cosine=0.5, sine_2=0.0, cosine_2=0.0)
    return space, without, refit(space, point, held=True)


def moved(space, first_only_um):
    """The recordings, the first stretch of the largest that is left out off by so much."""
    groups = space.groups
    at = int(np.argsort([np.ptp(g.drive_v) for g in groups.groups])[-2])
    group = groups.groups[at]
    measured = group.measured_um.copy()
    measured[:, : measured.shape[1] // CHUNKS] += first_only_um
    changed = list(groups.groups)
    changed[at] = group.with_measured(measured)
    return at, groups.with_(changed)


def test_one_stretch_that_runs_away_is_one_stretch(fitted):
    """Its mean is not taken for that of the recording: the others are where they were."""
    space, _, full = fitted
    plain = held_out_errors(space, full, "condition")
    at, there = moved(space, 0.1)
    off = held_out_errors(space, full, "condition", there)
    others = plain.group != at * CHUNKS
    assert off.usual[others] == pytest.approx(plain.usual[others], rel=0.05)
    assert off.rms_nm > plain.rms_nm + 10.0
    assert off.mostly_nm == pytest.approx(plain.mostly_nm, rel=0.05)


def test_of_whole_recordings_the_worst_counts():
    square, count = np.array([1.0, 4.0, 100.0]) * 1e-6, np.ones(3)
    errors = Errors(square, count, np.arange(3), 1.0)
    assert errors.mostly_nm == errors.rms_nm == pytest.approx(np.sqrt(35.0))
    assert errors.typical_nm == pytest.approx(np.cbrt(1.0 * 2.0 * 10.0))


def test_of_stretches_the_worst_of_each_recording_does_not():
    usual = np.array([9.0, 1.0, 1.0, 4.0]) * 1e-6
    errors = Errors(usual, np.ones(4), np.arange(4), 1.0, usual, stretches=2)
    assert errors.mostly_nm == pytest.approx(1.0)


def test_what_is_like_nothing_that_a_model_gets_wrong_need_not_predict_a_new_condition(fitted):
    """Where the elements are off by ten times as much, an error of 2 nm that is plain stays."""
    space, without, full = fitted
    assert full.evidence > without.evidence + 100.0

    def error(fitted):
        return 24.0 if fitted.point.model.stage("periodic-nonlinearity") is None else 24.1

    search = Search(
        space, without, np.random.default_rng(0), print,
        [(error, 1.03)], 2.0, 0, lambda less, fitted, unseen=True: False,
    )  # fmt: skip
    search.steps = [Step("periodic-nonlinearity", 1e-9, full)]
    assert not idle(search)
    assert search.causes == ["periodic-nonlinearity"]


def test_what_is_left_out_may_run_away_in_one_stretch(fitted):
    """The gates of a ladder ask for what is typical, and for most of every recording."""
    space, without, full = fitted
    search = Climbed(space, "condition", "condition", None, False, without, "condition")
    _, there = moved(space, 0.1)
    search._known[id(full.point)] = full.point, held_out_errors(space, full, "condition", there)
    assert search.error_nm(full) > 10.0
    for error, limit in search.gates(without):
        assert error(full) < limit * error(without)


def test_only_what_others_span_is_left_out(fitted):
    """Beyond it tables go where they like: an error there is of no model."""
    space, _, full = fitted
    far = int(np.argmax([np.ptp(g.drive_v) for g in space.groups.groups]))
    errors = held_out_errors(space, full, "condition")
    assert set(errors.group // CHUNKS) == {0, 1, 2} - {far}
    _at, there = moved(space, 0.0)
    further = list(there.groups)
    further[far] = further[far].with_measured(further[far].measured_um + 0.1)
    assert held_out_errors(space, full, "condition", there.with_(further)).rms_nm == errors.rms_nm


def test_a_loop_does_not_span_a_first_rise(fitted):
    """Of drives of one size a virgin one is spanned by another virgin one alone."""
    space, _, _ = fitted
    every = space.groups.groups
    far = int(np.argmax([np.ptp(g.drive_v) for g in every]))
    twins = [every[far], replace(every[far], history="unknown")]
    assert [_inside(space.groups.with_(twins), [k]) for k in (0, 1)] == [False, True]
    assert _inside(space.groups.with_([every[far], every[far]]), [0])


def test_one_of_two_recordings_is_left_out():
    """Its sensor has another gain, by a fiftieth: that much it is predicted wrong."""
    sweeps = recordings(conditions=PLAYED[:2], repeats=1)
    small = sweeps[1]
    moved_um = small.displacement_um
    sweeps[1] = replace(small, sensor_v=1.02 * small.sensor_v)
    space, plain = begun(sweeps)
    errors = held_out_errors(space, refit(space, plain), "sweep")
    assert errors.rms_nm == pytest.approx(1e3 * 0.02 * np.std(moved_um), rel=0.1)


def test_what_is_in_every_fit_is_said():
    found = diagnose(recordings(conditions=PLAYED, repeats=1))
    assert found.held_out == "condition"
    (note,) = [n for n in found.notes if n.startswith("in every fit")]
    assert note.endswith(": 0-75")
