"""TDMS files are read by their waveform properties or time channel, or refused with a reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recording_writers import triangle, write_tdms

from piezo_rig.errors import InputError
from piezo_rig.run_file.importers import Imported, ImportOptions, read_recordings
from piezo_rig.run_file.importers.tdms_segments import missing_bytes

NAME = "0-65 sense3 test 2.tdms"
START = np.datetime64("2012-05-06T07:08:09.125")
WAVEFORM = {"wf_increment": 0.001, "wf_start_offset": 0.5, "wf_start_time": START}


def read(path: Path, **options: object) -> Imported:
    return read_recordings([path], ImportOptions(**options))  # type: ignore[arg-type]


def test_time_comes_from_the_waveform_properties(tmp_path: Path) -> None:
    _, command, sensor = triangle(60)
    path = write_tdms(tmp_path / NAME, {"AO": command, "AI": sensor}, **WAVEFORM)
    imported = read(path)
    sweep = imported.sweeps[0]
    np.testing.assert_array_equal(sweep.command_v, command)
    np.testing.assert_array_equal(sweep.sensor_v, sensor)
    assert (sweep.sample_rate, sweep.sample_times_s) == (1000.0, None)
    assert sweep.start_time == pytest.approx(1336288089.125 + 0.5)
    assert (sweep.repeat, sweep.polarity, sweep.sensitivity_um_per_v) == (2, -1, 15.48)
    assert any("which is UTC" in line for line in imported.assumptions)
    assert any("command is column 1, 'Rig/AO'" in line for line in imported.assumptions)


def test_a_time_channel_counts_before_the_waveform_properties(tmp_path: Path) -> None:
    time, command, sensor = triangle(60)
    channels = {"Time": 2 * time, "AO": command, "AI": sensor}
    sweep = read(write_tdms(tmp_path / NAME, channels, wf_increment=1.0)).sweeps[0]
    assert sweep.sample_rate == 500.0
    np.testing.assert_array_equal(sweep.command_v, command)


def test_a_channel_of_time_stamps_is_time(tmp_path: Path) -> None:
    _, command, sensor = triangle(60)
    stamps = START + np.arange(60) * np.timedelta64(2000, "us")
    channels = {"Stamp": stamps, "AO": command, "AI": sensor}
    sweep = read(write_tdms(tmp_path / NAME, channels)).sweeps[0]
    assert sweep.sample_rate == pytest.approx(500.0)
    assert sweep.start_time == pytest.approx(1336288089.125)


def test_the_contracts_names_count_before_the_order(tmp_path: Path) -> None:
    _, drive, displacement = triangle(60)
    channels = {"displacement_um": displacement, "drive_v": drive}
    sweep = read(write_tdms(tmp_path / NAME, channels, **WAVEFORM)).sweeps[0]
    np.testing.assert_array_equal(sweep.drive_v, drive)
    np.testing.assert_array_equal(sweep.displacement_um, displacement)


def test_several_groups_are_listed_and_chosen_from(tmp_path: Path) -> None:
    _, command, sensor = triangle(60)
    path = tmp_path / NAME
    write_tdms(path, {"AO": command, "AI": sensor}, "First", **WAVEFORM)
    write_tdms(path, {"AO": command, "AI": 2 * sensor}, "Second", "a", **WAVEFORM)
    with pytest.raises(InputError, match="several groups") as caught:
        read(path)
    assert "4 'Second/AI'" in caught.value.remedy
    with pytest.raises(InputError, match="fits columns 1, 3"):
        read(path, command="AO")
    for options in ({"command": "Second/AO"}, {"command": "Second/AO", "sensor": 4}):
        sweep = read(path, **options).sweeps[0]
        np.testing.assert_array_equal(sweep.sensor_v, 2 * sensor)


def test_integers_and_words_beside_the_channels_do_no_harm(tmp_path: Path) -> None:
    _, command, sensor = triangle(60)
    path = tmp_path / NAME
    channels = {"Note": np.array(["a", "b"]), "AO": command.astype(np.int16), "AI": sensor}
    sweep = read(write_tdms(path, channels, **WAVEFORM)).sweeps[0]
    np.testing.assert_array_equal(sweep.command_v, command.astype(np.int16))


def test_unequal_lengths_are_cut_to_the_shortest(tmp_path: Path) -> None:
    _, command, sensor = triangle(60)
    path = write_tdms(tmp_path / NAME, {"AO": command, "AI": sensor[:50]}, **WAVEFORM)
    imported = read(path)
    assert imported.sweeps[0].samples == 50
    assert any("unequal lengths, 50 to 60" in line for line in imported.warnings)


def test_no_time_at_all_is_refused_with_a_remedy(tmp_path: Path) -> None:
    _, command, sensor = triangle(60)
    path = write_tdms(tmp_path / NAME, {"AO": command, "AI": sensor})
    with pytest.raises(InputError, match="says nowhere when") as caught:
        read(path)
    assert caught.value.code == "import-time"
    assert "--time" in caught.value.remedy


def test_a_hole_is_named_by_sample(tmp_path: Path) -> None:
    _, command, sensor = triangle(60)
    sensor[33] = np.nan
    path = write_tdms(tmp_path / NAME, {"AO": command, "AI": sensor}, **WAVEFORM)
    with pytest.raises(InputError, match="sample 33, column 'Rig/AI' is empty or NaN"):
        read(path)


def test_a_cut_file_gives_its_sound_part_or_an_error(tmp_path: Path) -> None:
    _, command, sensor = triangle(60)
    path = tmp_path / NAME
    write_tdms(path, {"AO": command, "AI": sensor}, **WAVEFORM)
    write_tdms(path, {"AO": command, "AI": sensor}, mode="a", **WAVEFORM)
    whole = path.read_bytes()
    outcomes = set()
    for cut in range(1, len(whole), 7):
        path.write_bytes(whole[:-cut])
        try:
            imported = read(path)
        except InputError as refused:
            assert refused.code.startswith("import-")
            outcomes.add("refused")
            continue
        sweep = imported.sweeps[0]
        expected = np.concatenate([sensor, sensor])[: sweep.samples]
        np.testing.assert_array_equal(sweep.sensor_v, expected)
        assert imported.warnings or sweep.samples in (60, 120)
        outcomes.add("used")
    assert outcomes == {"refused", "used"}


def test_of_a_file_that_lost_a_whole_channel_it_says_that_it_was_cut_off(tmp_path: Path) -> None:
    _, command, sensor = triangle(600)
    path = write_tdms(tmp_path / NAME, {"AO": command, "AI": sensor}, **WAVEFORM)
    whole = path.read_bytes()
    missing = sensor.nbytes + command.nbytes // 2  # channels lie one behind the other
    path.write_bytes(whole[:-missing])
    with pytest.raises(InputError, match="channel 'AI' holds no sample") as error:
        read(path)
    assert f"{missing} bytes" in str(error.value.cause)
    path.write_bytes(whole)
    assert missing_bytes(whole) == 0
    assert read(path).sweeps[0].samples == 600


def test_a_stale_index_file_beside_the_recording_is_not_looked_at(tmp_path: Path) -> None:
    _, command, sensor = triangle(60)
    path = write_tdms(tmp_path / NAME, {"AO": command, "AI": sensor}, **WAVEFORM)
    Path(f"{path}_index").write_bytes(b"TDSh" + b"\xff" * 60)
    assert read(path).sweeps[0].samples == 60


def test_a_scaling_without_end_is_refused(tmp_path: Path) -> None:
    _, command, sensor = triangle(60)
    path = write_tdms(
        tmp_path / NAME, {"AO": command, "AI": sensor}, NI_Number_Of_Scales=2_000_000_000
    )
    with pytest.raises(InputError, match="NI_Number_Of_Scales"):
        read(path)


@pytest.mark.parametrize(
    "content", [b"TDSm", b"TDSm" + b"\xff" * 300, b"abc", b"\x89HDF\r\n\x1a\n"]
)
def test_what_is_no_tdms_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / NAME
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read(path)
    assert caught.value.code == "import-tdms"
