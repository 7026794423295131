"""What a recording does not say is asked for, and what is wrong with it is said as it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recording_writers import RATE, csv_text, lvm_text, triangle, write, write_tdms

from piezo_rig.errors import InputError
from piezo_rig.run_file.importers import ImportOptions, read_recordings

ANY = ImportOptions(sensitivity="2")
HEADER = "time_s,drive_v,displacement_um"


def refused(path: Path, options: ImportOptions = ANY) -> str:
    with pytest.raises(InputError) as caught:
        read_recordings([path], options)
    assert caught.value.exit_status == 2
    return f"{caught.value.what}; {caught.value.cause}"


@pytest.mark.parametrize("name", ["time_ms", "foo", "Time (us)", "frequency"])
def test_a_first_column_that_is_not_time_in_seconds_is_named_and_not_taken(tmp_path, name):
    path = write(tmp_path / "a.csv", csv_text(f"{name},drive_v,displacement_um", [*triangle(50)]))
    assert f"'{name}' is not known to be time in seconds" in refused(path)
    chosen = read_recordings([path], ImportOptions(time=name))
    assert chosen.sweeps[0].sample_rate == RATE
    assert any("read in seconds" in w for w in chosen.warnings) == ("(" in name or "_" in name)


@pytest.mark.parametrize(
    ("last", "kept"),
    [
        ("0.049,1.5,2.3675", True),  # as long as the others
        ("0.049,1.5,2", False),  # shorter than all others: perhaps 2.3675 was to come
        ("0.049,1.5", False),
        ("0.049,1.5,", False),
        ("0.049,1.5,2.3675e-", False),
    ],
)
def test_a_last_line_without_its_end_is_kept_where_it_cannot_be_a_part(tmp_path, last, kept):
    rows = [f"{k / 1000},{k * 0.03:.2f},{k * 0.047:.4f}" for k in range(49)]
    path = write(tmp_path / "a.csv", "\n".join([HEADER, *rows, last]))
    imported = read_recordings([path])
    assert imported.sweeps[0].samples == 49 + kept
    assert any("line 51 ends without" in w for w in imported.warnings) == (not kept)


def test_numbers_of_any_length_may_end_without_a_line_end_near_the_ones_before(tmp_path):
    rows = [f"{k / 1000!r},{k / 30!r},{k / 17!r}" for k in range(49)]
    kept = write(tmp_path / "a.csv", "\n".join([HEADER, *rows, "0.049,1.65,2.9"]))
    imported = read_recordings([kept])
    assert imported.sweeps[0].samples == 50
    assert any("its sample was kept" in line for line in imported.assumptions)
    cut = write(tmp_path / "b.csv", "\n".join([HEADER, *rows, "0.049,1.65,29"]))
    assert read_recordings([cut]).sweeps[0].samples == 49


def test_a_drive_keeps_one_row_for_every_row_wherever_it_ends(tmp_path):
    path = write(tmp_path / "d.csv", "time_s,drive_v\n0,0\n0.1,0\n0.2,0\n0.3,0\n0.4,75")
    (sweep,) = read_recordings([path], require=("drive",)).sweeps
    np.testing.assert_array_equal(sweep.drive_v, [0, 0, 0, 0, 75])


def test_a_missing_number_is_named_by_sample_too(tmp_path):
    rows = csv_text(HEADER, [*triangle(50)]).split("\n")
    rows[8] = "0.007,nan,1"
    assert "line 9, column 'drive_v' is empty or NaN at sample 7" in refused(
        write(tmp_path / "a.csv", "\n".join(rows))
    )
    first = lvm_text([*triangle(50)])
    second = lvm_text([*triangle(50)], file_header=False, clock="10:30:00")
    lines = second.split("\r\n")
    lines[-11] = lines[-11].rsplit("\t", 1)[0] + "\tinf"
    said = refused(write(tmp_path / "a.lvm", first + "\r\n".join(lines)))
    assert "is inf at sample 40 of segment 2" in said


@pytest.mark.parametrize("step", ["-0.001000", "0.000000"])
def test_a_spacing_that_is_none_is_said_as_it_is(tmp_path, step):
    lvm = lvm_text([*triangle(50)][1:], x_columns="No", delta_x=step)
    assert f"a spacing (Delta_X, wf_increment) of {float(step):g} s" in refused(
        write(tmp_path / "a.lvm", lvm)
    )
    _, command, sensor = triangle(50)
    path = write_tdms(tmp_path / "a.tdms", {"c": command, "s": sensor}, wf_increment=float(step))
    assert f"of {float(step):g} s" in refused(path)


def test_an_lvm_channel_named_time_is_not_the_command(tmp_path):
    time, command, sensor = triangle(50)
    text = lvm_text([time, time, command, sensor], names=("Time", "Command", "Sensor"))
    (sweep,) = read_recordings([write(tmp_path / "a.lvm", text)], ANY).sweeps
    np.testing.assert_array_equal(sweep.command_v, command)
    # and it is the time of a file whose own time column is empty
    text = lvm_text(
        [time * 2, command, sensor], names=("Time", "Command", "Sensor"), x_columns="No"
    )
    (sweep,) = read_recordings([write(tmp_path / "b.lvm", text)], ANY).sweeps
    assert sweep.sample_rate == RATE / 2
    np.testing.assert_array_equal(sweep.command_v, command)


def tdms_of_two_starts(path: Path, seconds: float) -> Path:
    _, command, sensor = triangle(400)
    start = np.datetime64("2023-04-05T10:11:12.500000")
    later = start + np.timedelta64(round(seconds * 1e6), "us")
    for mode, part, stamp in (("w", slice(0, 200), start), ("a", slice(200, 400), later)):
        channels = {"Command": command[part], "Sensor": sensor[part]}
        write_tdms(path, channels, mode=mode, wf_increment=1 / RATE, wf_start_time=stamp)
    return path


def test_segments_of_a_tdms_that_begin_apart_are_sweeps_with_their_own_starts(tmp_path):
    path = tdms_of_two_starts(tmp_path / "a.tdms", 60.0)
    imported = read_recordings([path], ANY)
    assert [s.samples for s in imported.sweeps] == [200, 200]
    assert imported.offsets_s == [0.0, pytest.approx(60.0, abs=1e-6)]
    np.testing.assert_array_equal(imported.sweeps[1].command_v, triangle(400)[1][200:])
    assert any("2 parts that do not follow each other" in w for w in imported.warnings)


@pytest.mark.parametrize("late", [0.0, 0.003])
def test_segments_that_follow_each_other_are_one_sweep_from_the_first_start(tmp_path, late):
    imported = read_recordings([tdms_of_two_starts(tmp_path / "a.tdms", 0.2 + late)], ANY)
    (sweep,) = imported.sweeps
    assert sweep.samples == 400
    assert sweep.start_time == np.datetime64("2023-04-05T10:11:12.5", "ms").astype(int) / 1000
    assert any("off its sampling" in w for w in imported.warnings) == bool(late)


def test_a_file_of_empty_lines_is_not_called_binary(tmp_path):
    said = refused(write(tmp_path / "a.csv", "\n\n\n"))
    assert "nothing but empty lines" in said
    assert "binary" not in said


def test_files_of_one_name_keep_apart_and_repeat_only_what_was_played_alike(tmp_path):
    time, command, sensor = triangle(400)
    paths = []
    for folder, drive in (("a", command + 10), ("b", 2 * (command + 10)), ("c", command + 10)):
        (tmp_path / folder).mkdir()
        text = csv_text(HEADER, [time, drive, sensor])
        paths.append(write(tmp_path / folder / "x.csv", text))
    imported = read_recordings(paths)
    assert [s.source for s in imported.sweeps] == ["a/x.csv", "b/x.csv", "c/x.csv"]
    first, second, third = imported.sweeps
    assert (first.condition, first.repeat) == ("x", 1)
    assert second.condition == "x, 0 to 16 V, 5 cycles/s"
    assert (third.condition, third.repeat) == ("x", 2)
    assert any(w.startswith("b/x.csv: plays 0 to 16 V") for w in imported.warnings)


def test_another_pace_is_another_condition_and_a_cut_repeat_is_not(tmp_path):
    time, drive, y = triangle(1000)
    write(tmp_path / "x test 1.csv", csv_text(HEADER, [time, drive, y]))
    write(tmp_path / "x test 2.csv", csv_text(HEADER, [time[:650], drive[:650], y[:650]]))
    write(tmp_path / "x test 3.csv", csv_text(HEADER, [time * 2, drive, y]))
    imported = read_recordings([tmp_path / f"x test {k}.csv" for k in (1, 2, 3)])
    assert [s.condition for s in imported.sweeps][:2] == ["x", "x"]
    assert imported.sweeps[2].condition.startswith("x, ")
