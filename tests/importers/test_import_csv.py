"""Tables with a header are read as the contract says, or refused with line and column."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recording_writers import csv_text, triangle, write

from piezo_rig.errors import InputError
from piezo_rig.run_file.importers import Imported, ImportOptions, read_recordings

DRIVE = "time_s,drive_v,displacement_um"
VOLTS = "time_s,command_v,sensor_v"


def read(path: Path, **options: object) -> Imported:
    return read_recordings([path], ImportOptions(**options))  # type: ignore[arg-type]


def test_drive_and_displacement_are_taken_as_they_are(tmp_path: Path) -> None:
    time, drive, displacement = triangle(50)
    path = write(tmp_path / "loop.csv", csv_text(DRIVE, [time, drive, displacement]))
    sweep = read(path).sweeps[0]
    np.testing.assert_array_equal(sweep.drive_v, drive)
    np.testing.assert_array_equal(sweep.displacement_um, displacement)
    assert (sweep.gain, sweep.offset_v, sweep.sensitivity_um_per_v) == (1, 0, 1)
    assert (sweep.polarity, sweep.zero_v, sweep.sample_rate) == (1, 0, 1000.0)


def test_options_that_cannot_apply_are_said_to_be_ignored(tmp_path: Path) -> None:
    path = write(tmp_path / "loop.csv", csv_text(DRIVE, [*triangle(50)]))
    imported = read(
        path, offset_v=5.0, sensitivity="3", gain=2.0, explicit=frozenset({"gain"})
    )
    assert imported.sweeps[0].gain == 1
    assert imported.sweeps[0].offset_v == 0
    assert len([w for w in imported.warnings if "ignored" in w]) == 2


def test_a_sensor_on_the_other_side_is_turned_round_where_that_is_said(tmp_path: Path) -> None:
    path = write(tmp_path / "loop.csv", csv_text(DRIVE, [*triangle(50)]))
    as_it_is = read(path).sweeps[0].displacement_um
    turned = read(path, polarity=-1, explicit=frozenset({"polarity"}))
    np.testing.assert_array_equal(turned.sweeps[0].displacement_um, -as_it_is)
    assert any("turned" in note for note in turned.assumptions)


def test_command_and_sensor_need_gain_offset_and_sensitivity(tmp_path: Path) -> None:
    time, command, sensor = triangle(50)
    path = write(tmp_path / "volts.csv", csv_text(VOLTS, [time, command, sensor]))
    options = {"gain": 2.0, "offset_v": 5.0, "sensitivity": "3.87um/V", "polarity": 1}
    sweep = read(path, **options).sweeps[0]
    np.testing.assert_allclose(sweep.drive_v, 2 * command + 5)
    np.testing.assert_allclose(sweep.displacement_um, (sensor - sensor[0]) * 3.87)


def test_a_sensor_without_sensitivity_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "volts.csv", csv_text(VOLTS, [*triangle(50)]))
    with pytest.raises(InputError, match="sensitivity is not known") as caught:
        read(path)
    assert caught.value.code == "import-sensitivity"
    assert caught.value.exit_status == 2
    assert "1um/V" in caught.value.remedy


def test_an_uncalibrated_sensor_is_one_micrometre_per_volt_when_told_so(tmp_path: Path) -> None:
    time, command, sensor = triangle(50)
    path = write(tmp_path / "volts.csv", csv_text(VOLTS, [time, command, sensor]))
    sweep = read(path, sensitivity="1um/V").sweeps[0]
    np.testing.assert_allclose(sweep.displacement_um, -(sensor - sensor[0]))


def test_drive_with_a_raw_sensor(tmp_path: Path) -> None:
    time, drive, sensor = triangle(50)
    path = write(tmp_path / "a.csv", csv_text("time_s,drive_v,sensor_v", [time, drive, sensor]))
    sweep = read(path, sensitivity="2").sweeps[0]
    np.testing.assert_array_equal(sweep.drive_v, drive)
    np.testing.assert_allclose(sweep.displacement_um, -(sensor - sensor[0]) * 3.87)


def test_command_with_ready_displacement(tmp_path: Path) -> None:
    time, command, displacement = triangle(50)
    text = csv_text("time_s,command_v,displacement_um", [time, command, displacement])
    sweep = read(write(tmp_path / "a.csv", text)).sweeps[0]
    np.testing.assert_allclose(sweep.drive_v, 7.5 * command + 75)
    np.testing.assert_array_equal(sweep.displacement_um, displacement)


def test_bipolar_drives_are_kept(tmp_path: Path) -> None:
    time = np.arange(400) / 1e4
    drive = np.round(30 * np.sin(2 * np.pi * 100 * time), 6)
    text = csv_text(DRIVE, [time, drive, 0.01 * drive])
    sweep = read(write(tmp_path / "a.csv", text)).sweeps[0]
    np.testing.assert_array_equal(sweep.drive_v, drive)
    assert sweep.sample_rate == 10_000.0


@pytest.mark.parametrize(
    ("separator", "decimal"), [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ",")]
)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_every_dialect_gives_the_same_numbers(
    tmp_path: Path, separator: str, decimal: str, end: str, encoding: str
) -> None:
    time, drive, displacement = triangle(50)
    text = csv_text(
        "displacement_um,drive_monitor_v,time_s,note,drive_v",
        [displacement, drive + 0.5, time, time, drive],
        separator,
        decimal,
    )
    text = f"# recorded by hand, see notebook; page 3{end}{end}" + text.replace("\n", end)
    imported = read(write(tmp_path / "a.csv", text, encoding))
    sweep = imported.sweeps[0]
    np.testing.assert_array_equal(sweep.drive_v, drive)
    np.testing.assert_array_equal(sweep.displacement_um, displacement)
    assert sweep.drive_monitor_v is not None
    np.testing.assert_allclose(sweep.drive_monitor_v, drive + 0.5)
    assert any("not used: 'note'" in line for line in imported.assumptions)


def test_what_numpy_savetxt_writes_is_read(tmp_path: Path) -> None:
    table = np.column_stack(triangle(50))
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header=DRIVE)
    np.testing.assert_array_equal(read(tmp_path / "a.csv").sweeps[0].drive_v, table[:, 1])


def test_quoted_cells_and_spaces_are_read(tmp_path: Path) -> None:
    text = '"Time (s)", "Drive [V]" ,"Displacement [µm]"\n"0", "1.5" ,2\n"0.1",2.5 ,"3"\n'
    sweep = read(write(tmp_path / "a.csv", text, "utf-8")).sweeps[0]
    np.testing.assert_array_equal(sweep.drive_v, [1.5, 2.5])
    assert sweep.sample_rate == 10


def test_a_headerless_table_needs_every_channel_named(tmp_path: Path) -> None:
    time, drive, displacement = triangle(50)
    text = csv_text(DRIVE, [time, drive, displacement]).split("\n", 1)[1]
    path = write(tmp_path / "a.csv", text)
    with pytest.raises(InputError):
        read(path)
    sweep = read(path, time=1, command=2, sensor=3, sensitivity="1um/V").sweeps[0]
    np.testing.assert_array_equal(sweep.command_v, drive)


def test_other_peoples_names_are_chosen_by_option(tmp_path: Path) -> None:
    time, drive, displacement = triangle(50)
    path = write(tmp_path / "a.csv", csv_text("t,U,x", [time, drive, displacement]))
    with pytest.raises(InputError, match="drive or command") as caught:
        read(path)
    assert "2 'U'" in caught.value.remedy
    sweep = read(path, command="U", sensor="x", sensitivity="1um/V", gain=1.0, offset_v=0.0)
    np.testing.assert_array_equal(sweep.sweeps[0].drive_v, drive)


def test_a_drive_alone_is_enough_where_nothing_else_is_asked(tmp_path: Path) -> None:
    time, drive, _ = triangle(50)
    path = write(tmp_path / "a.csv", csv_text("time_s,drive_v", [time, drive]))
    sweep = read_recordings([path], require=("drive",)).sweeps[0]
    np.testing.assert_array_equal(sweep.drive_v, drive)
    assert np.isnan(sweep.sensor_v).all()
    with pytest.raises(InputError, match="displacement or sensor"):
        read(path)


def test_a_displacement_alone_is_enough_for_a_target(tmp_path: Path) -> None:
    time, displacement, _ = triangle(50)
    path = write(tmp_path / "a.csv", csv_text("time_s,displacement_um", [time, displacement]))
    sweep = read_recordings([path], require=("displacement",)).sweeps[0]
    np.testing.assert_array_equal(sweep.displacement_um, displacement)
    assert np.isnan(sweep.command_v).all()


# -- damage ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("0.010,,3", "line 12, column 'drive_v' is empty or NaN"),
        ("0.010,nan,3", "line 12, column 'drive_v' is empty or NaN"),
        ("0.010,1,inf", "column 'displacement_um' is inf"),
        ("0.010,one,3", "line 12 column 'drive_v': 'one' is not a number"),
        ("0.010,1", "line 12 has 2 of 3 cells"),
        ("0,010,1,5,3,0", "line 12 has 6 cells under 3 names"),
        ("0.010,1,2,3", "line 12 has 4 cells under 3 names"),
    ],
)
def test_a_bad_row_is_named_by_line(tmp_path: Path, row: str, words: str) -> None:
    lines = csv_text(DRIVE, [*triangle(50)]).split("\n")
    lines[11] = row
    with pytest.raises(InputError, match=words) as caught:
        read(write(tmp_path / "a.csv", "\n".join(lines)))
    assert caught.value.code == "import-csv"


def test_mixed_decimals_are_refused(tmp_path: Path) -> None:
    text = csv_text(DRIVE, [*triangle(50)], ";", ",") + "0,050;1.234,5;1,0\n"
    with pytest.raises(InputError, match=r"line 52 column 'drive_v': '1\.234,5'"):
        read(write(tmp_path / "a.csv", text))


def test_a_last_row_that_was_cut_off_is_dropped(tmp_path: Path) -> None:
    time, drive, displacement = triangle(50)
    text = csv_text(DRIVE, [time, drive, displacement])
    for cut in range(1, 40):
        imported = read(write(tmp_path / "a.csv", text[:-cut]))
        n = imported.sweeps[0].samples
        np.testing.assert_array_equal(imported.sweeps[0].displacement_um, displacement[:n])
        assert n >= 48
        whole = text[:-cut].splitlines()[-1] in text.splitlines()
        assert whole or imported.warnings


def test_a_file_padded_with_zero_bytes_is_used_up_to_them(tmp_path: Path) -> None:
    text = csv_text(DRIVE, [*triangle(50)]) + "\0" * 512
    imported = read(write(tmp_path / "a.csv", text))
    assert imported.sweeps[0].samples == 50
    assert any("512 zero bytes" in line for line in imported.warnings)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\x89HDF\r\n\x1a\n" + b"\0" * 100, "an HDF5 file"),
        (b"TDSm" + b"\0" * 100, "a TDMS file"),
        (b"LabVIEW Measurement\t\r\n", "a LabVIEW measurement file"),
        (b"PK\x03\x04" + b"\0" * 100, "spreadsheet"),
        (b"", "is empty"),
        (b"\0" * 100, "zero bytes"),
        (b"time_s,drive_v\0,displacement_um\n1,2,3\n", "not text"),
        (b"time_s,drive_v,displacement_um\n", "holds no samples"),
        (b"# nothing\n", "no table"),
        (b"time_s,drive_v,displacement_um\n0,1,2\n", "two at least"),
        (b"drive_v,displacement_um\n0,1\n1,2\n", "no column time_s"),
        (b"time_s,displacement_um\n0,1\n1,2\n", "drive or command"),
        (b"time_s,drive_v,drive_v,displacement_um\n0,1,1,1\n1,2,2,2\n", "2 columns are named"),
        (b"x" * 200_000, "more than 100000 bytes"),
        (b"time_s,drive_v,displacement_um\n0,1,2\n1e300,2,3\n", "1e\\+300"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=words) as refused:
        read(path)
    assert refused.value.remedy


@pytest.mark.parametrize("name", ["folder.csv", "missing.csv", "notes.txt", "no_extension"])
def test_what_is_no_file_of_recordings_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(InputError) as caught:
        read(tmp_path / name)
    assert caught.value.code == "import-file"
    assert name in caught.value.what


@pytest.mark.parametrize(
    "options", [{"command": 9}, {"command": 0}, {"command": "nope"}, {"sensor": "drive_v",
                                                                       "command": "drive_v"}]
)  # fmt: skip
def test_a_channel_that_is_not_there_is_refused_with_what_is(
    tmp_path: Path, options: dict[str, object]
) -> None:
    path = write(tmp_path / "a.csv", csv_text(DRIVE, [*triangle(50)]))
    with pytest.raises(InputError) as caught:
        read(path, **options)
    assert caught.value.code == "import-channel"
    assert "2 'drive_v'" in caught.value.remedy


@pytest.mark.shared
@pytest.mark.parametrize(("name", "n"), [("sine_1hz", 8027), ("decaying_and_holds", 14155)])
def test_the_micromanipulator_is_read_as_it_stands(shared: Path, name: str, n: int) -> None:
    path = shared / "data" / "micromanipulator" / f"{name}.csv"
    expected = [[float(c) for c in line.split(",")] for line in path.read_text().split()[1:]]
    imported = read(path)
    sweep = imported.sweeps[0]
    assert (sweep.samples, sweep.sample_rate, imported.warnings) == (n, 200.0, [])
    np.testing.assert_array_equal(
        np.column_stack([sweep.drive_v, sweep.displacement_um]), np.array(expected)[:, 1:]
    )


@pytest.mark.parametrize(("cut", "kept"), [(0, 40), (3, 40), (12, 39)])
def test_a_bare_drive_may_lack_its_last_line_end_but_no_cell_of_its_last_row(tmp_path, cut, kept):
    rows = [f"{k / 10!r},{20 + k * 0.1234567!r}" for k in range(40)]
    text = "time_s,drive_v\n" + "\n".join(rows)
    path = write(tmp_path / "joined.csv", text[: len(text) - cut])
    (sweep,) = read_recordings([path], require=("drive",)).sweeps
    assert sweep.drive_v.size == kept


@pytest.mark.parametrize(("header", "cause"), [
    ("t,voltage,pos\n", "no column is named"), ("", "no header"),
])  # fmt: skip
def test_a_table_without_known_names_is_told_which_to_write(
    tmp_path: Path, header: str, cause: str
) -> None:
    rows = "\n".join(f"{i / 5000:.4f},{v:.4f},{0.1 * v:.4f}" for i, v in enumerate(range(60)))
    (tmp_path / "a.csv").write_text(header + rows)
    with pytest.raises(InputError) as caught:
        read(tmp_path / "a.csv")
    assert cause in caught.value.cause
    assert "time_s,drive_v,displacement_um" in caught.value.remedy


@pytest.mark.parametrize(("step_s", "said"), [(1.0, True), (0.5, True), (0.001, False)])
def test_times_that_may_be_milliseconds_are_doubted(tmp_path: Path, step_s, said) -> None:
    volts = np.abs((np.arange(2001) % 1000) - 500.0) / 10.0
    time = 3.0 + step_s * np.arange(volts.size)
    path = write(tmp_path / "loop.csv", csv_text(DRIVE, [time, volts, 0.1 * volts]))
    imported = read(path)
    assert imported.sweeps[0].sample_rate == 1.0 / step_s  # taken as it says
    assert any("milliseconds" in w for w in imported.warnings) == said
