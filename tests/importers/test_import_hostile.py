"""Any file is a correct reading or a clear error: never a traceback, never minutes or gigabytes."""

from __future__ import annotations

import struct
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recording_writers import csv_text, lvm_text, triangle, write_tdms

from piezo_rig.errors import InputError
from piezo_rig.run_file.importers import ImportOptions, read_recordings

OPTIONS = ImportOptions(sensitivity="1um/V")
FUZZ = settings(
    max_examples=150,
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
TOKENS = (
    "LabVIEW Measurement", "***End_of_Header***", "***Start_Special***", "***End_Special***",
    "Separator", "Tab", "Comma", "Decimal_Separator", "X_Columns", "No", "One", "Multi", "Channels",
    "Samples", "X_Value", "Comment", "Delta_X", "X0", "Date", "2011/13/45", "2011/03/04", "Time",
    "25:61:61", "10:20:30,5", "time_s", "drive_v", "displacement_um", "command_v", "sensor_v", "#",
    "sep=;", '"', "\t", "\t", "\t", ",", ";", ".", "\n", "\n", "\r\n", "\r", " ", "0", "1", "2",
    "0.001", "-1.5", "1E-3", "1e308", "-1e308", "1e-320", "nan", "inf", "9" * 400, "1_0", "0x1",
    "\0", "\ufeff", "é", "__import__('os').abort()", "2" * 20,
)  # fmt: skip


def outcome(path: Path) -> str:
    """Read a file; anything but sound sweeps or an ``InputError`` fails the test."""
    try:
        imported = read_recordings([path], OPTIONS)
    except InputError as refused:
        assert refused.code.startswith("import-")
        assert path.name in refused.what
        assert len(refused.block()) < 4000
        return "refused"
    for sweep in imported.sweeps:
        assert sweep.samples >= 2
        assert sweep.command_v.shape == sweep.sensor_v.shape == sweep.time_s.shape
        assert np.isfinite(sweep.drive_v).all()
        assert np.isfinite(sweep.displacement_um).all()
        assert (np.diff(sweep.time_s) > 0).all()
        assert np.isfinite([sweep.sample_rate, sweep.start_time]).all()
    return "read"


def damaged(data: bytes, edits: list[tuple[int, bytes, int]]) -> bytes:
    """Replace stretches: where (modulo the length), by what, and how many bytes give way."""
    for where, new, gone in edits:
        at = where % (len(data) + 1)
        data = data[:at] + new + data[at + gone :]
    return data


EDITS = st.lists(
    st.tuples(
        st.integers(0, 10_000),
        st.one_of(st.binary(max_size=6), st.sampled_from([t.encode() for t in TOKENS])),
        st.integers(0, 40),
    ),
    min_size=1,
    max_size=4,
)


@FUZZ
@given(words=st.lists(st.sampled_from(TOKENS), max_size=60), suffix=st.sampled_from(["lvm", "csv"]))
def test_any_mixture_of_the_formats_words(tmp_path: Path, words: list[str], suffix: str) -> None:
    path = tmp_path / f"fuzz.{suffix}"
    path.write_text("".join(words), encoding="utf-8", newline="")
    outcome(path)


@FUZZ
@given(edits=EDITS, x_columns=st.sampled_from(["No", "One", "Multi"]), comma=st.booleans())
def test_any_damage_to_a_labview_file(
    tmp_path: Path, edits: list[tuple[int, bytes, int]], x_columns: str, comma: bool
) -> None:
    t, command, sensor = triangle(12)
    columns = {"No": [command, sensor], "One": [t, command, sensor]}.get(
        x_columns, [t, command, t, sensor]
    )
    text = lvm_text(columns, x_columns=x_columns, decimal="," if comma else ".")
    text += "\r\n" + lvm_text(columns, x_columns=x_columns, file_header=False)
    path = tmp_path / "fuzz.lvm"
    path.write_bytes(damaged(text.encode("cp1252"), edits))
    outcome(path)


@FUZZ
@given(edits=EDITS, separator=st.sampled_from([",", ";", "\t"]))
def test_any_damage_to_a_table(
    tmp_path: Path, edits: list[tuple[int, bytes, int]], separator: str
) -> None:
    text = csv_text("time_s,drive_v,displacement_um", [*triangle(30)], separator)
    path = tmp_path / "fuzz.csv"
    path.write_bytes(damaged(text.encode(), edits))
    outcome(path)


@pytest.fixture(scope="module")
def tdms_bytes(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    _, command, sensor = triangle(40)
    path = write_tdms(
        tmp_path_factory.mktemp("tdms") / "a.tdms", {"AO": command, "AI": sensor},
        wf_increment=0.001, wf_start_time=np.datetime64("2012-05-06T07:08:09"),
    )  # fmt: skip
    return path.read_bytes()


@FUZZ
@given(edits=EDITS)
def test_any_damage_to_a_tdms_file(
    tmp_path: Path, tdms_bytes: bytes, edits: list[tuple[int, bytes, int]]
) -> None:
    path = tmp_path / "fuzz.tdms"
    path.write_bytes(damaged(tdms_bytes, edits))
    outcome(path)


@FUZZ
@given(data=st.binary(max_size=200), suffix=st.sampled_from(["lvm", "csv", "tdms"]))
def test_any_bytes_at_all(tmp_path: Path, data: bytes, suffix: str) -> None:
    path = tmp_path / f"fuzz.{suffix}"
    path.write_bytes(data)
    outcome(path)


# -- bombs: under 1 MB of file, under 5 s and 500 MB of work --------------------

MB = 1_000_000
LVM = b"LabVIEW Measurement\t\nX_Columns\tOne\n***End_of_Header***\t\n"
SEGMENT = b"\nChannels\t2\n***End_of_Header***\nX_Value\tA\tB\n0\t1\t2\n1\t1\t3\n"
BOMBS = {
    "one huge line.csv": b"1," * (MB // 2),
    "a million names.csv": b",".join([b"time_s"] * 14_000) + b"\n" + b"1\n" * 400_000,
    "only line ends.csv": b"time_s,drive_v,displacement_um\n" + b"\n" * MB,
    "only quotes.csv": b"time_s,drive_v,displacement_um\n" + b'"\n' * (MB // 2),
    "quoted rows.csv": b"time_s,drive_v,displacement_um\n" + b'"0","1","2"\n' * 80_000,
    "only comments.csv": b"#\n" * (MB // 2),
    "gaps.csv": b"time_s,drive_v,displacement_um\n"
    + b"".join(b"%d,%d,%d\n" % (i * i, i % 2, i % 3) for i in range(50_000)),
    "long digits.csv": b"time_s,drive_v,displacement_um\n"
    + (b"0," + b"9" * 90_000 + b",1\n") * 10,
    "long digits.lvm": LVM + SEGMENT + (b"0\t" + b"9" * 90_000 + b"\t1\n") * 10,
    "many segments.lvm": LVM + SEGMENT * (MB // len(SEGMENT)),
    "many blocks.lvm": LVM + SEGMENT + b"\n0\t1\t2\n1\t2\t3\n" * 60_000,
    "many following blocks.lvm": LVM + SEGMENT
    + b"".join(b"\n%d\t%d\t2\n" % (i, i % 7) for i in range(2, 70_000)),
    "many specials.lvm": LVM + b"***Start_Special***\n***End_Special***\n" * 25_000,
    "open specials.lvm": LVM + b"***Start_Special***\n" * 50_000,
    "many headers.lvm": LVM * (MB // len(LVM)),
    "many keys.lvm": b"LabVIEW Measurement\t\n" + b"".join(b"k%d\t1\n" % i for i in range(90_000)),
    "many channels.lvm": LVM + b"Channels\t999999\n***End_of_Header***\n"
    + b"X_Value\t" + b"A\t" * 40_000 + b"\n0\t1\t2\n",
    "tiny segments.tdms": b"TDSm" + struct.pack("<llQQ", 0b1110, 4713, 4, 4) + struct.pack("<L", 0)
    + (b"TDSm" + struct.pack("<llQQ", 0, 4713, 0, 0)) * 35_000,
}  # fmt: skip


def object_bomb() -> bytes:
    """Many objects, and many segments that repeat them all without saying so."""
    def text(word: str) -> bytes:
        return struct.pack("<L", len(word)) + word.encode()

    objects = b"".join(
        text(f"/'g'/'{i}'") + struct.pack("<LL", 0xFFFFFFFF, 0) for i in range(18_000)
    )
    meta = struct.pack("<L", 18_000) + objects
    first = b"TDSm" + struct.pack("<llQQ", 0b0110, 4713, len(meta), len(meta)) + meta
    again = b"TDSm" + struct.pack("<llQQ", 0b0010, 4713, 4, 4) + struct.pack("<L", 0)
    return first + again * 15_000


def chunk_bomb() -> bytes:
    """Two channels of one byte a chunk, so that every byte is a chunk of its own."""
    def text(word: str) -> bytes:
        return struct.pack("<L", len(word)) + word.encode()

    index = struct.pack("<LLLQ", 20, 5, 1, 1)  # uint8, one value
    objects = [text(f"/'g'/'{name}'") + index + struct.pack("<L", 0) for name in "ab"]
    meta = struct.pack("<L", 2) + b"".join(objects)
    size = 900_000
    return b"TDSm" + struct.pack("<llQQ", 0b1110, 4713, len(meta) + size, len(meta)) + meta + (
        bytes(range(200)) * (size // 200)
    )


BOMBS["many objects.tdms"] = object_bomb()
BOMBS["many chunks.tdms"] = chunk_bomb()


@pytest.mark.parametrize("name", list(BOMBS))
def test_a_small_file_costs_little(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(BOMBS[name])
    assert path.stat().st_size < 1.1 * MB
    started = time.monotonic()
    outcome(path)
    assert time.monotonic() - started < 5


@pytest.mark.parametrize("name", ["quoted rows.csv", "many blocks.lvm"])
def test_a_small_file_takes_little_memory(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(BOMBS[name][:100_000])
    tracemalloc.start()
    try:
        outcome(path)
        assert tracemalloc.get_traced_memory()[1] < 50 * MB
    finally:
        tracemalloc.stop()


def test_numbers_near_the_largest_before_a_torn_row(tmp_path: Path) -> None:
    """Their differences are beyond what a double holds; found by `make study-fuzz`."""
    path = tmp_path / "torn.lvm"
    rows = b"".join(b"%d\t%s1%se308\t2\n" % (k, b"-" * (k % 2), b"." + b"0" * k) for k in range(6))
    path.write_bytes(LVM + b"\nChannels\t2\n***End_of_Header***\nX_Value\tA\tB\n" + rows
                     + b"6\t1.0e308\t3")
    outcome(path)
