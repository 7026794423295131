"""Names, options, clocks and damage: what holds for recordings of every format."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recording_writers import csv_text, lvm_text, triangle, write

from piezo_rig.errors import InputError
from piezo_rig.run_file.importers import (
    ImportOptions,
    NameSays,
    parse_name,
    parse_sensitivity,
    read_recordings,
)

DRIVE = "time_s,drive_v,displacement_um"


@pytest.mark.parametrize(
    ("stem", "says"),
    [
        ("0-65 sense3 test 1", NameSays("0-65", 1, 3, (0, 65))),
        ("75-5 sense3 test 12", NameSays("75-5", 12, 3, (5, 75))),
        ("5-75-5 Step5 sense3 test 1", NameSays("5-75-5 Step5", 1, 3, None)),
        ("0-7.5V_Sense 2_repeat2", NameSays("0-7.5V", 2, 2, (0, 7.5))),
        ("-10-10 test2", NameSays("-10-10", 2, None, (-10, 10))),
        ("sine_1hz", NameSays("sine_1hz")),
        ("2016-08-23 loop", NameSays("2016-08-23 loop")),
        ("0-65 2Hz sense0", NameSays("0-65 2Hz", None, 0, (0, 65))),
        ("contest 5 nonsense3", NameSays("contest 5 nonsense3")),
        ("sense3 test 1", NameSays("sense3 test 1", 1, 3)),
        ("loop sense3.87", NameSays("loop sense3.87")),
    ],
)
def test_a_name_says_condition_sensitivity_and_repeat(stem: str, says: NameSays) -> None:
    assert parse_name(stem) == says


@pytest.mark.parametrize(
    ("text", "value"),
    [("0", 0.24), ("1", 0.97), ("2", 3.87), ("3", 15.48), ("4", 61.9), ("5", 247.61),
     ("6", 990.44), ("3.87um/V", 3.87), (" 1 µm/V ", 1.0), ("250nm/V", 0.25), ("1e-1um/V", 0.1)],
)  # fmt: skip
def test_sensitivity_is_a_switch_or_a_figure(text: str, value: float) -> None:
    assert parse_sensitivity(text)[0] == pytest.approx(value)


@pytest.mark.parametrize("text", ["7", "-1", "3.87", "um/V", "0um/V", "-2um/V", "", "nanum/V",
                                  "1e999um/V", "3um/V;rm"])  # fmt: skip
def test_any_other_sensitivity_is_refused(text: str) -> None:
    with pytest.raises(InputError) as caught:
        ImportOptions(sensitivity=text)
    assert caught.value.code == "import-sensitivity"


@pytest.mark.parametrize(
    "options",
    [{"gain": 0.0}, {"gain": float("nan")}, {"offset_v": float("inf")}, {"polarity": 2},
     {"history": "forgotten"}],
)  # fmt: skip
def test_options_without_meaning_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(InputError):
        ImportOptions(**options)  # type: ignore[arg-type]


def test_an_option_wins_over_the_name_and_it_is_said(tmp_path: Path) -> None:
    path = write(tmp_path / "0-60 sense3 test 1.lvm", lvm_text([*triangle(400)]))
    imported = read_recordings([path], ImportOptions(sensitivity="2"))
    assert imported.sweeps[0].sensitivity_um_per_v == 3.87
    assert any("its name says sensitivity switch 3" in line for line in imported.warnings)
    assert read_recordings([path], ImportOptions(sensitivity="3")).warnings == []


def test_every_assumption_is_a_sentence_and_nothing_given_is_assumed(tmp_path: Path) -> None:
    path = write(tmp_path / "0-60 sense3 test 1.lvm", lvm_text([*triangle(400)]))
    text = "\n".join(read_recordings([path]).assumptions)
    for words in ("command is column 2", "sensor is column 3", "gain 7.5", "offset 75", "polarity",
                  "switch 3", "1000 samples/s", "UTC", "history unknown"):  # fmt: skip
        assert words in text
    given = ImportOptions(
        gain=7.5, offset_v=75.0, polarity=-1, sensitivity="15.48um/V", command=2, sensor=3,
        history="virgin", explicit=frozenset({"gain", "offset_v", "history"}),
    )  # fmt: skip
    text = "\n".join(read_recordings([path], given).assumptions)
    for words in ("command is", "sensor is", "gain", "offset 75", "polarity", "switch", "history"):
        assert words not in text


def test_a_drive_that_is_not_as_named_is_said(tmp_path: Path) -> None:
    path = write(tmp_path / "0-60 sense3 test 1.lvm", lvm_text([*triangle(400)]))
    wrong = ImportOptions(gain=10.0, offset_v=75.0)
    assert any("its name says 0 to 60 V" in w for w in read_recordings([path], wrong).warnings)


def test_what_holds_of_many_files_is_said_once(tmp_path: Path) -> None:
    paths = [
        write(tmp_path / f"0-60 sense3 test {i}.lvm", lvm_text([*triangle(400)],
              clock=f"10:20:{i:02d}.0"))
        for i in range(1, 9)
    ]  # fmt: skip
    imported = read_recordings(paths)
    assert [sweep.repeat for sweep in imported.sweeps] == list(range(1, 9))
    assert {sweep.condition for sweep in imported.sweeps} == {"0-60"}
    assert [sweep.name for sweep in imported.sweeps][-1] == "sweep_0008"
    assert len(imported.assumptions) < 12
    assert imported.offsets_s == pytest.approx(list(range(8)))
    assert imported.warnings == []


def test_a_repeat_given_twice_is_counted_on(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    text = csv_text(DRIVE, [*triangle(50)])
    later = csv_text(DRIVE, [triangle(50)[0] + 9, *triangle(50)[1:]])
    paths = [write(tmp_path / "x test 1.csv", text), write(tmp_path / "b" / "x test 1.csv", later)]
    imported = read_recordings(paths)
    assert [sweep.repeat for sweep in imported.sweeps] == [1, 2]
    assert any("counts as repeat 2" in line for line in imported.warnings)


def test_names_that_only_count_are_told_by_what_was_played(tmp_path: Path) -> None:
    time, drive, displacement = triangle(400)
    played = {"s01": 1.0, "s02": 0.5, "s03": 1.0, "s04": 0.5, "s05": 1.0}
    paths = [
        write(tmp_path / f"{name}.csv", csv_text(DRIVE, [time + 9 * k, drive * size, displacement]))
        for k, (name, size) in enumerate(played.items())
    ]
    imported = read_recordings(paths)
    assert [(s.condition, s.repeat) for s in imported.sweeps] == [
        ("s01", 1), ("s02", 1), ("s01", 2), ("s02", 2), ("s01", 3),
    ]  # fmt: skip
    assert any("s03.csv" in a and "repeat of condition 's01'" in a for a in imported.assumptions)
    assert imported.warnings == []


@pytest.mark.parametrize(
    ("names", "sizes"),
    [
        (("0-75 loaded 1", "0-75 bare 1"), (1.0, 1.0)),  # words say that they differ
        (("s01", "s02"), (1.0, 0.99)),  # so do drives, by 0.6 V of 60
    ],
)
def test_what_differs_by_more_than_a_count_is_no_repeat(
    tmp_path: Path, names: tuple[str, str], sizes: tuple[float, float]
) -> None:
    time, drive, displacement = triangle(400)
    paths = [
        write(tmp_path / f"{name}.csv", csv_text(DRIVE, [time + 9 * k, drive * size, displacement]))
        for k, (name, size) in enumerate(zip(names, sizes, strict=True))
    ]
    assert len({s.condition for s in read_recordings(paths).sweeps}) == 2


def test_tables_share_the_clock_of_their_times(tmp_path: Path) -> None:
    time, drive, displacement = triangle(50)
    first = write(tmp_path / "a.csv", csv_text(DRIVE, [time + 5, drive, displacement]))
    second = write(tmp_path / "b.csv", csv_text(DRIVE, [time + 65, drive, displacement]))
    imported = read_recordings([first, second])
    assert [sweep.start_time for sweep in imported.sweeps] == [5, 65]
    assert imported.warnings == []
    again = read_recordings([second, first])
    assert again.offsets_s == [60, 0]
    assert any("order of their times" in line for line in again.warnings)


def test_an_order_by_name_is_nothing_to_speak_of(tmp_path: Path) -> None:
    time, drive, displacement = triangle(50)
    first = write(tmp_path / "a.csv", csv_text(DRIVE, [time + 65, drive, displacement]))
    second = write(tmp_path / "b.csv", csv_text(DRIVE, [time + 5, drive, displacement]))
    imported = read_recordings([first, second])
    assert imported.offsets_s == [60, 0]
    assert imported.warnings == []


def test_a_folder_is_no_recording(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", csv_text(DRIVE, [*triangle(50)]))
    with pytest.raises(InputError, match="is a folder"):
        read_recordings([tmp_path])


def test_recordings_that_overlap_or_have_two_clocks_are_said(tmp_path: Path) -> None:
    text = csv_text(DRIVE, [*triangle(50)])
    a, b = write(tmp_path / "a.csv", text), write(tmp_path / "b.csv", text)
    c = write(tmp_path / "c sense3.lvm", lvm_text([*triangle(50)]))
    assert any("overlap" in line for line in read_recordings([a, b]).warnings)
    assert any("do not share one clock" in line for line in read_recordings([a, c]).warnings)


def test_a_carried_history_carries_the_zero_with_it(tmp_path: Path) -> None:
    time, command, sensor = triangle(50)
    for i, shift in enumerate((0.0, 0.1)):
        text = csv_text("time_s,command_v,sensor_v", [time + i, command, sensor + shift])
        write(tmp_path / f"{i}.csv", text)
    options = ImportOptions(history="carried", sensitivity="1um/V")
    first, second = read_recordings([tmp_path / "0.csv", tmp_path / "1.csv"], options).sweeps
    assert (first.history, second.history) == ("unknown", "carried")
    assert second.zero_v == first.zero_v == sensor[0]
    plain = read_recordings([tmp_path / "1.csv"], ImportOptions(sensitivity="1um/V")).sweeps[0]
    assert plain.zero_v == pytest.approx(sensor[0] + 0.1)


# -- time -----------------------------------------------------------------------


@pytest.mark.parametrize("rate", [5000.0, 44_100.0, 60_000.0, 199.7, 3.0, 1e6])
def test_a_rate_is_recovered_from_printed_times(tmp_path: Path, rate: float) -> None:
    time = np.arange(3000) / rate
    text = csv_text(DRIVE, [time, np.sin(time * rate / 100), np.cos(time * rate / 100)])
    sweep = read_recordings([write(tmp_path / "a.csv", text)]).sweeps[0]
    assert sweep.sample_times_s is None
    assert sweep.sample_rate == pytest.approx(rate, rel=1e-6 / time[-1] * 1.1)


@pytest.mark.parametrize("rate", [6000.0, 10_000.0, 20_000.0])
def test_a_rate_is_recovered_from_times_with_six_significant_digits(
    tmp_path: Path, rate: float
) -> None:
    rows = [f"{i / rate:.6g},{np.sin(i / 500):.6g},{np.cos(i / 500):.6g}" for i in range(30_000)]
    text = "time_s,drive_v,displacement_um\n" + "\n".join(rows) + "\n"
    sweep = read_recordings([write(tmp_path / "a.csv", text)]).sweeps[0]
    assert sweep.sample_times_s is None
    assert sweep.sample_rate == rate


def test_one_dropped_sample_is_seen_however_coarse_the_times(tmp_path: Path) -> None:
    time = np.delete(np.arange(5000) / 5000, 2500)
    text = csv_text(DRIVE, [time, np.sin(time * 9), np.cos(time * 9)])
    imported = read_recordings([write(tmp_path / "a.csv", text)])
    assert any("between samples 2499 and 2500" in line for line in imported.warnings)


def test_a_missing_stretch_is_kept_as_a_gap(tmp_path: Path) -> None:
    time, drive, displacement = triangle(400)
    keep = np.r_[0:150, 151:400]
    text = csv_text(DRIVE, [time[keep], drive[keep], displacement[keep]])
    imported = read_recordings([write(tmp_path / "a.csv", text)])
    sweep = imported.sweeps[0]
    np.testing.assert_allclose(sweep.time_s, time[keep], atol=1e-12)
    assert sweep.sample_rate == pytest.approx(1000)
    assert any("0.002 s pass between samples 149 and 150" in line for line in imported.warnings)


def test_uneven_samples_keep_their_times(tmp_path: Path) -> None:
    time, drive, displacement = triangle(400)
    time = np.round(time + 3e-4 * np.sin(np.arange(400)), 6)
    imported = read_recordings(
        [write(tmp_path / "a.csv", csv_text(DRIVE, [time, drive, displacement]))]
    )
    np.testing.assert_allclose(imported.sweeps[0].time_s, time, atol=1e-12)
    assert any("uneven" in line for line in imported.assumptions)


@pytest.mark.parametrize(("value", "words"), [(0.002, "runs backwards"), (0.029, "stands still")])
def test_time_that_does_not_go_on_is_refused(tmp_path: Path, value: float, words: str) -> None:
    time, drive, displacement = triangle(50)
    time[30] = value
    path = write(tmp_path / "a.csv", csv_text(DRIVE, [time, drive, displacement]))
    with pytest.raises(InputError, match=rf"{words} at sample 30 \(line 32\)"):
        read_recordings([path])


# -- damage ---------------------------------------------------------------------


def test_a_sensor_at_its_stop_is_named_by_samples(tmp_path: Path) -> None:
    time, drive, _ = triangle(400)
    sensor = np.minimum(drive, -4.0)
    path = write(tmp_path / "a.csv", csv_text(DRIVE, [time, drive, sensor]))
    first = int(np.flatnonzero(drive >= -4.0)[0])
    warnings = read_recordings([path]).warnings
    assert any("highest value, -4" in w and f"first samples {first} to" in w for w in warnings)


def test_a_sensor_that_rests_while_the_drive_rests_is_not_saturated(tmp_path: Path) -> None:
    time, drive, _ = triangle(400)
    drive = np.clip(drive, -9.0, -4.0)
    path = write(tmp_path / "a.csv", csv_text(DRIVE, [time, drive, 0.1 * drive]))
    assert read_recordings([path]).warnings == []


def test_a_sensor_that_never_moves_is_said(tmp_path: Path) -> None:
    time, drive, _ = triangle(400)
    path = write(tmp_path / "a.csv", csv_text(DRIVE, [time, drive, 0 * drive]))
    assert any("never moves" in line for line in read_recordings([path]).warnings)
