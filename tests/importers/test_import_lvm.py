"""LabVIEW measurement files are read in every dialect, or refused with a place and a reason."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from recording_writers import lvm_text, triangle, write

from piezo_rig.errors import InputError
from piezo_rig.run_file.importers import Imported, ImportOptions, read_recordings

NAME = "0-65 sense3 test 1.lvm"
START = datetime(2011, 3, 4, 10, 20, 30, 250000, tzinfo=UTC).timestamp()


def read(path: Path, **options: object) -> Imported:
    return read_recordings([path], ImportOptions(**options))  # type: ignore[arg-type]


@pytest.mark.parametrize("end", ["\r\n", "\n", "\r", "\r\r\n"])
@pytest.mark.parametrize("separator", ["\t", ",", ";"])
@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("x_columns", ["No", "One", "Multi"])
def test_every_dialect_gives_the_same_sweep(
    tmp_path: Path, x_columns: str, decimal: str, separator: str, end: str
) -> None:
    if decimal == separator:
        pytest.skip("LabVIEW does not write this")
    time, command, sensor = triangle(60)
    columns = {
        "No": [command, sensor],
        "One": [time, command, sensor],
        "Multi": [time, command, time, sensor],
    }[x_columns]
    text = lvm_text(columns, x_columns=x_columns, decimal=decimal, separator=separator, end=end)

    sweep = read(write(tmp_path / NAME, text)).sweeps[0]

    np.testing.assert_array_equal(sweep.command_v, command)
    np.testing.assert_array_equal(sweep.sensor_v, sensor)
    np.testing.assert_allclose(sweep.drive_v, 7.5 * command + 75)
    np.testing.assert_allclose(sweep.displacement_um, -(sensor - sensor[0]) * 15.48)
    assert sweep.sample_rate == 1000.0
    assert sweep.sample_times_s is None
    assert sweep.start_time == pytest.approx(START, abs=1e-6)
    assert (sweep.condition, sweep.repeat, sweep.polarity) == ("0-65", 1, -1)
    assert (sweep.origin, sweep.history) == ("IMPORTED", "unknown")


def test_a_decimal_comma_that_an_old_version_does_not_announce_is_seen(tmp_path: Path) -> None:
    time, command, sensor = triangle(30)
    text = lvm_text([time, command, sensor], decimal=",", declare_decimal=False)
    sweep = read(write(tmp_path / NAME, text)).sweeps[0]
    np.testing.assert_array_equal(sweep.command_v, command)


def test_a_decimal_point_is_kept_where_only_the_clock_has_a_comma(tmp_path: Path) -> None:
    time, command, sensor = triangle(30)
    text = lvm_text([time, command, sensor], declare_decimal=False, clock="10:20:30,25")
    sweep = read(write(tmp_path / NAME, text)).sweeps[0]
    np.testing.assert_array_equal(sweep.sensor_v, sensor)
    assert sweep.start_time == pytest.approx(START, abs=1e-6)


def test_special_blocks_are_skipped(tmp_path: Path) -> None:
    text = lvm_text([*triangle(30)], special=True)
    assert read(write(tmp_path / NAME, text)).sweeps[0].samples == 30


def test_comments_after_the_numbers_are_not_channels(tmp_path: Path) -> None:
    lines = lvm_text([*triangle(30)]).split("\r\n")
    lines[-3] += "\tpiezo squeaked, 3,5 times"
    imported = read(write(tmp_path / NAME, "\r\n".join(lines)))
    assert imported.sweeps[0].samples == 30
    assert imported.sweeps[0].drive_monitor_v is None


def test_a_third_channel_is_the_drive_monitor(tmp_path: Path) -> None:
    time, command, sensor = triangle(30)
    text = lvm_text([time, command, sensor, 7.5 * command + 75])
    imported = read(write(tmp_path / NAME, text))
    monitor = imported.sweeps[0].drive_monitor_v
    assert monitor is not None
    np.testing.assert_allclose(monitor, 7.5 * command + 75, atol=1e-6)
    assert any("monitor is column 4, 'Monitor'" in line for line in imported.assumptions)


@pytest.mark.parametrize(("command", "sensor"), [("Sensor", "Command"), (3, 2), ("3", "command")])
def test_channels_are_chosen_by_name_or_number(
    tmp_path: Path, command: str | int, sensor: str | int
) -> None:
    time, first, second = triangle(30)
    path = write(tmp_path / NAME, lvm_text([time, first, second]))
    sweep = read(path, command=command, sensor=sensor).sweeps[0]
    np.testing.assert_array_equal(sweep.command_v, second)
    np.testing.assert_array_equal(sweep.sensor_v, first)


def test_a_file_without_any_header_is_time_command_sensor(tmp_path: Path) -> None:
    time, command, sensor = triangle(40)
    rows = [f"{t:.6f}\t{c:.6f}\t{s:.6f}" for t, c, s in zip(time, command, sensor, strict=True)]
    imported = read(write(tmp_path / NAME, "\r\n".join(rows) + "\r\n"))
    np.testing.assert_array_equal(imported.sweeps[0].command_v, command)
    assert imported.sweeps[0].sample_rate == 1000.0
    assert any("no header" in line for line in imported.assumptions)
    assert any("without" in line or "no date" in line for line in imported.assumptions)


def test_times_counted_from_1904_are_a_date(tmp_path: Path) -> None:
    time, command, sensor = triangle(30)
    absolute = time + START + 2_082_844_800
    sweep = read(write(tmp_path / NAME, lvm_text([absolute, command, sensor]))).sweeps[0]
    assert sweep.start_time == pytest.approx(START, abs=1e-5)
    assert sweep.sample_rate == pytest.approx(1000.0)
    assert sweep.sample_times_s is None


# -- segments -------------------------------------------------------------------


def segments(second: str, **first: object) -> str:
    time, command, sensor = triangle(40)
    return lvm_text([time, command, sensor], **first) + "\r\n" + second  # type: ignore[arg-type]


def test_segments_that_follow_each_other_in_time_are_one_sweep(tmp_path: Path) -> None:
    time, command, sensor = triangle(80)
    text = lvm_text([time[:40], command[:40], sensor[:40]]) + "\r\n"
    text += lvm_text([time[40:], command[40:], sensor[40:]], file_header=False)
    (sweep,) = read(write(tmp_path / NAME, text)).sweeps
    np.testing.assert_array_equal(sweep.command_v, command)
    assert (sweep.sample_rate, sweep.sample_times_s) == (1000.0, None)


def test_segments_without_times_follow_by_their_clock(tmp_path: Path) -> None:
    _, command, sensor = triangle(80)
    text = lvm_text([command[:40], sensor[:40]], x_columns="No") + "\r\n"
    text += lvm_text(
        [command[40:], sensor[40:]], x_columns="No", file_header=False, clock="10:20:30.29"
    )
    (sweep,) = read(write(tmp_path / NAME, text)).sweeps
    np.testing.assert_array_equal(sweep.sensor_v, sensor)


def test_segments_apart_in_time_are_sweeps_of_one_clock(tmp_path: Path) -> None:
    second = lvm_text([*triangle(40)], file_header=False, clock="10:21:30.25")
    imported = read(write(tmp_path / NAME, segments(second)))
    # both play the same drive: the second repeats the first
    assert [(s.condition, s.repeat) for s in imported.sweeps] == [
        ("0-65 part 1", 1), ("0-65 part 1", 2),
    ]  # fmt: skip
    assert imported.offsets_s == pytest.approx([0, 60])
    assert any("2 parts" in line for line in imported.warnings)


def test_a_second_block_without_a_header_is_read_with_the_first_one(tmp_path: Path) -> None:
    time, command, sensor = triangle(80)
    whole = lvm_text([time, command, sensor]).split("\r\n")
    whole.insert(-41, "")
    imported = read(write(tmp_path / NAME, "\r\n".join(whole)))
    np.testing.assert_array_equal(imported.sweeps[0].command_v, command)
    assert any("without a header" in line for line in imported.warnings)


def test_a_headerless_block_that_begins_again_is_a_sweep_of_its_own(tmp_path: Path) -> None:
    rows = "".join(
        f"{t:.6f}\t{c:.6f}\t{s:.6f}\r\n" for t, c, s in zip(*triangle(40), strict=True)
    )
    imported = read(write(tmp_path / NAME, segments(rows)))
    assert [sweep.samples for sweep in imported.sweeps] == [40, 40]


def test_a_special_block_between_rows_does_not_break_the_sweep(tmp_path: Path) -> None:
    _, command, sensor = triangle(80)
    lines = lvm_text([command, sensor], x_columns="No").split("\r\n")
    lines[-41:-41] = ["***Start_Special***", "whatever\t1", "***End_Special***"]
    (sweep,) = read(write(tmp_path / NAME, "\r\n".join(lines))).sweeps
    np.testing.assert_array_equal(sweep.command_v, command)


# -- damage ---------------------------------------------------------------------


def test_a_last_row_that_was_cut_off_is_dropped_and_never_a_wrong_number(tmp_path: Path) -> None:
    time, command, sensor = triangle(50)
    text = lvm_text([time, command, sensor])
    for cut in range(1, 60):
        torn = text[: len(text) - cut]
        imported = read(write(tmp_path / NAME, torn))
        n = imported.sweeps[0].samples
        assert n >= 47
        np.testing.assert_array_equal(imported.sweeps[0].sensor_v, sensor[:n])
        assert n == 50 or imported.warnings


def test_fewer_samples_than_announced_are_said(tmp_path: Path) -> None:
    imported = read(write(tmp_path / NAME, lvm_text([*triangle(50)], samples=800)))
    assert any("announces 800 samples and the file holds 50" in w for w in imported.warnings)


def test_channels_of_unequal_length_are_cut_to_the_shortest(tmp_path: Path) -> None:
    lines = lvm_text([*triangle(50)], comment=False).split("\r\n")
    for i in (-2, -3, -4):
        lines[i] = lines[i].rsplit("\t", 1)[0] + "\t"
    imported = read(write(tmp_path / NAME, "\r\n".join(lines)))
    assert imported.sweeps[0].samples == 47
    assert any("unequal lengths, 47 to 50" in w for w in imported.warnings)


@pytest.mark.parametrize(
    ("cell", "words"),
    [("", "empty or NaN"), ("NaN", "empty or NaN"), ("1.2.3", "is not a number"),
     ("1e999", "inf"), ("__import__('os')", "is not a number"), ("0x1F", "is not a number"),
     ("1_0", "is not a number"), ("9" * 90, r"1e\+90")],
)  # fmt: skip
def test_a_bad_cell_is_named_by_line_and_column(tmp_path: Path, cell: str, words: str) -> None:
    lines = lvm_text([*triangle(50)]).split("\r\n")
    line = len(lines) - 11
    cells = lines[line].split("\t")
    lines[line] = "\t".join([*cells[:2], cell])
    with pytest.raises(InputError, match=words) as caught:
        read(write(tmp_path / NAME, "\r\n".join(lines)))
    assert caught.value.code == "import-lvm"
    assert f"line {line + 1}" in caught.value.what
    assert "'Sensor'" in caught.value.what


def test_time_that_stands_still_is_named_by_sample(tmp_path: Path) -> None:
    time, command, sensor = triangle(50)
    time[20] = time[19]
    with pytest.raises(InputError, match="stands still at sample 20") as caught:
        read(write(tmp_path / NAME, lvm_text([time, command, sensor])))
    assert caught.value.code == "import-time"


def test_time_columns_that_disagree_are_refused(tmp_path: Path) -> None:
    time, command, sensor = triangle(50)
    text = lvm_text([time, command, 2 * time, sensor], x_columns="Multi")
    with pytest.raises(InputError, match="'Sensor' was not sampled when 'Command' was"):
        read(write(tmp_path / NAME, text))


def test_time_columns_a_fraction_of_a_sample_apart_are_said(tmp_path: Path) -> None:
    time, command, sensor = triangle(50)
    text = lvm_text([time, command, time + 1e-5, sensor], x_columns="Multi")
    imported = read(write(tmp_path / NAME, text))
    assert any("1e-05 s away" in line for line in imported.warnings)


@pytest.mark.parametrize(
    "text",
    [
        "LabVIEW Measurement\t\r\nWriter_Version\t2\r\n",
        "LabVIEW Measurement\t\n***End_of_Header***\t\n",
        "LabVIEW Measurement\t\n***End_of_Header***\t\n\nChannels\t2\n***End_of_Header***\n"
        "X_Value\tA\tB\n",
        "LabVIEW Measurement\t\n***Start_Special***\n",
        "LabVIEW Measurement\t\n***End_of_Header***\nChannels\t900000\n***End_of_Header***\n1\t2\n",
        "LabVIEW Measurement\t\n***End_of_Header***\nDelta_X\t__import__('os')\n"
        "X_Columns\tNo\nChannels\t2\n***End_of_Header***\n\t1\t2\n\t1\t3\n",
        "time_s,drive_v,displacement_um\n0,1,2\n1,2,3\n",
        "once upon a time\nthere was a piezo\n",
        "1",
        "\n\n\n",
    ],
)
def test_what_is_no_recording_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError) as caught:
        read(write(tmp_path / NAME, text))
    assert caught.value.code in ("import-lvm", "import-channel", "import-time")
    assert NAME in caught.value.what


# -- real files -----------------------------------------------------------------


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "command", "sensor", "rate"),
    [
        ("short", 0, 1, 25600.0),
        ("multi_time_column", 1, 3, 51200.0),
        ("no_decimal_separator", 1, 3, 4000.0),
        ("with_comments", 1, 2, None),
    ],
)
def test_other_peoples_files_agree_with_lvm_read(
    shared: Path, name: str, command: int, sensor: int, rate: float | None
) -> None:
    lvm_read = pytest.importorskip("lvm_read")
    path = shared / "data" / "lvm" / f"{name}.lvm"
    oracle = lvm_read.read(str(path), read_from_pickle=False, dump_file=False)[0]["data"]
    sweep = read(path, sensitivity="1um/V").sweeps[0]
    np.testing.assert_array_equal(sweep.command_v, oracle[:, command])
    np.testing.assert_array_equal(sweep.sensor_v, oracle[:, sensor])
    if rate is None:
        np.testing.assert_allclose(sweep.time_s, oracle[:, 0])
    else:
        assert sweep.sample_rate == rate
