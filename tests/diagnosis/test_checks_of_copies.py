"""A recording that was given twice is said to be a copy: it is no repeat."""

from __future__ import annotations

from small_bench import recordings

from piezo_rig.diagnosis.checks import data_warnings
from piezo_rig.diagnosis.grouping import group_tracks
from piezo_rig.identification import prepare


def warned(sweeps):
    return data_warnings(group_tracks(prepare(sweeps, first_rises=True), sweeps), sweeps)


def test_a_recording_given_twice_is_called_a_copy():
    first, *others = recordings(repeats=1)
    copy = first.with_(name="sweep_0099", repeat=2)
    (said,) = warned([first, *others, copy])
    assert "sweep_0099 holds the same samples as sweep_0001" in said


def test_so_is_one_whose_file_was_given_twice():
    sweeps = [s.with_(source=f"{s.condition}.csv") for s in recordings(repeats=1)]
    (said,) = warned([*sweeps, sweeps[0].with_(repeat=2)])
    assert said.count(f"{sweeps[0].condition}.csv") == 2


def test_repeats_with_noise_of_their_own_are_none():
    assert warned(recordings(repeats=2)) == []
