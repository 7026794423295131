"""A given model knows the drives that it was identified from, and is held to what it says there."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from small_bench import recordings

from piezo_rig.diagnosis import diagnose
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.diagnosis.held import own_um_of, within_its_drives, within_its_first_rise
from piezo_rig.identification import identify, prepare

UP_TO_70 = (("0-20", 0.0, 20.0), ("0-30", 0.0, 30.0), ("0-70", 0.0, 70.0))
FURTHER = (*UP_TO_70, ("0-75", 0.0, 75.0))
NOISE_NM = 2.0


@pytest.fixture(scope="module")
def reference():
    return identify(recordings(seed=4, conditions=UP_TO_70), "classical").model


def groups_of(sweeps):
    return group_tracks(prepare(sweeps, first_rises=True, clipped=True), sweeps)


def test_within_its_drives_it_is_off_by_less_than_where_it_has_to_go_beyond(reference):
    # the largest condition, left out, asks for 40 V that no other one has
    assert reference.provenance["rms_nm"] > 3.0 * NOISE_NM
    assert reference.provenance["within_nm"] < 1.5 * NOISE_NM
    same = groups_of(recordings(seed=4, conditions=UP_TO_70))
    assert own_um_of(reference, same) == 1e-3 * reference.provenance["within_nm"]
    beyond = groups_of(recordings(seed=4, conditions=FURTHER))
    assert own_um_of(reference, beyond) == 1e-3 * reference.provenance["rms_nm"]


def test_without_a_word_of_its_drives_it_is_held_to_all_that_it_says(reference):
    said = {k: v for k, v in reference.provenance.items() if k != "drive_v"}
    same = groups_of(recordings(seed=4, conditions=UP_TO_70))
    silent = reference.with_(provenance=said)
    assert own_um_of(silent, same) == 1e-3 * reference.provenance["rms_nm"]


def test_recordings_beyond_are_left_out_and_named(reference):
    sweeps = recordings(seed=4, conditions=FURTHER)
    kept, notes = within_its_drives(sweeps, reference)
    assert {s.condition for s in kept} == {"0-20", "0-30", "0-70"}
    assert len(notes) == 1
    assert "0-75" in notes[0]
    assert "0 to 70 V" in notes[0]
    assert within_its_drives(kept, reference) == (kept, [])


def test_recordings_that_carry_on_stay_together(reference):
    carried = [s.with_(history="carried") for s in recordings(seed=4, conditions=FURTHER)]
    assert within_its_drives(carried, reference) == (carried, [])


def test_where_all_go_beyond_they_are_all_there_is(reference):
    beyond = recordings(seed=4, conditions=FURTHER[-1:])
    assert within_its_drives(beyond, reference) == (beyond, [])


@pytest.fixture(scope="module")
def of_later_branches():
    """From recordings that do not say what the actuator remembers: first rises are not used."""
    return identify(unsaid(recordings(seed=4, conditions=UP_TO_70)), "classical").model


def unsaid(sweeps):
    return [s.with_(history="unknown") for s in sweeps]


def test_a_first_rise_is_compared_as_far_as_the_model_knows_one(of_later_branches):
    assert of_later_branches.provenance["known_v"]["first_rise"] == pytest.approx(35.0, rel=0.01)
    sweeps = unsaid(recordings(seed=4, conditions=UP_TO_70))
    data = prepare(sweeps, first_rises=True, clipped=True)
    cut, notes = within_its_first_rise(data, of_later_branches)
    assert len(notes) == 1
    assert "up to 35 V" in notes[0]
    for old, new in zip(data.tracks, cut.tracks, strict=True):
        assert old.virgin
        drive = old.drive_v
        if drive.max() < 35.0:
            assert new is old
            continue
        (begin, passes), (turns, end) = new.blocks
        assert (begin, end) == (0, drive.size)
        assert drive[passes] == pytest.approx(35.0, abs=1.0)
        assert abs(turns - np.argmax(drive)) <= drive.size // 100
        assert new.unit == (0, 0)


def test_a_model_of_first_rises_and_one_that_does_not_say_are_compared_all_the_way(
    reference, of_later_branches
):
    sweeps = unsaid(recordings(seed=4, conditions=UP_TO_70))
    data = prepare(sweeps, first_rises=True, clipped=True)
    assert reference.provenance["known_v"]["first_rise"] == pytest.approx(70.0, rel=0.01)
    said = {k: v for k, v in of_later_branches.provenance.items() if k != "known_v"}
    for model in (reference, of_later_branches.with_(provenance=said)):
        assert within_its_first_rise(data, model) == (data, [])
    for damaged in (None, {}, {"first_rise": "35"}, {"first_rise": True}, [35.0]):
        model = of_later_branches.with_(provenance={**said, "known_v": damaged})
        assert within_its_first_rise(data, model) == (data, [])


@pytest.mark.study
def test_what_a_model_does_not_know_of_a_first_rise_is_no_initiation_stage(of_later_branches):
    later = unsaid(recordings(
        seed=4, conditions=UP_TO_70, sensor=lambda x, t, rng: x / 1.02
    ))  # fmt: skip
    found = diagnose(later, of_later_branches)
    assert [f.cause for f in found.findings] == ["sensor-scale"]


@pytest.mark.study
def test_five_volts_more_have_no_name(reference):
    """What an actuator does where the model never was is no initiation stage and no scale."""
    found = diagnose(recordings(seed=4, conditions=FURTHER), reference)
    assert [f.cause for f in found.findings] == []
    assert any("0-75" in n for n in found.notes)


@pytest.mark.study
def test_a_scale_of_half_a_percent_is_seen(reference):
    """Noise and all it is what the model is off by, and far less than it was off beyond."""
    faster = [(*c, 3.0) for c in UP_TO_70]  # so that the model's own recordings tell nothing
    later = recordings(seed=4, conditions=faster, sensor=lambda x, t, rng: x / 1.005)
    found = diagnose(later, reference)
    assert [f.cause for f in found.findings] == ["sensor-scale"]
    assert found.findings[0].parameters["ratio"].value == pytest.approx(1.005, abs=3e-4)


def test_cycles_that_are_held_out_of_one_sweep_are_within_what_the_others_swing():
    """Not the fit's own error, which any model of enough elements brings down."""
    alone = recordings(seed=4, conditions=UP_TO_70[-1:], repeats=1)
    said = identify(alone, "classical").model.provenance
    assert said["held_out"] == "cycles"
    assert said["within_nm"] == said["rms_nm"]


@pytest.mark.parametrize("ends", [["0", "70"], [0.0], None, "0-70"])
def test_a_damaged_word_of_its_drives_is_none(reference, ends):
    model = reference.with_(provenance=reference.provenance | {"drive_v": ends})
    sweeps = recordings(seed=4, conditions=FURTHER)
    assert within_its_drives(sweeps, model) == (sweeps, [])
