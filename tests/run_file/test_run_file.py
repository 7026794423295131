"""The run file: raw and complete, readable after a crash, one clear error when damaged."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from piezo_rig.errors import BenchError, InputError, PiezoRigError
from piezo_rig.run_file.close import recover
from piezo_rig.run_file.layout import InstrumentRecord, RunHeader, SweepHeader
from piezo_rig.run_file.reader import Run
from piezo_rig.run_file.verify import verify
from piezo_rig.run_file.writer import RunWriter, part_path

HEADER = RunHeader(
    title="test", origin="SIMULATED", protocol_text="x = 'ü'", plan_hash="ab", rig_config="",
    operator="", actuator={"model": "stack"}, start_time="2026-01-01T00:00:00+00:00",
    clock_start=0.0, software_version="0", git_revision="",
    instruments=(InstrumentRecord("waveform_dac", "A,B,SIM1,1", "SIM1", {"load": "INF"}),),
)


def header_of(name: str, samples: int = 1000, **changes) -> SweepHeader:
    return SweepHeader(
        name=name, samples=samples, sample_rate=5000.0, gain=7.5, offset_v=75.0,
        sensitivity_um_per_v=15.48, polarity=-1, condition="0-65", repeat=1, history="virgin",
        details={"lower_v": 0.0, "upper_v": 65.0, "cycles": 2}, **changes,
    )


def recording(samples: int = 1000):
    """Command of one triangle to 65 V, a sensor that follows it, and the drive."""
    drive = 65.0 * (1 - np.abs(2 * np.arange(samples) / samples - 1))
    return (drive - 75.0) / 7.5, 0.2 - 0.15 * drive / 15.48, drive


def written(path: Path, sweeps: int = 2, **changes) -> Path:
    writer = RunWriter(path, HEADER, [header_of(f"sweep_{i + 1:04d}", **changes)
                                      for i in range(sweeps)])
    command, sensor, drive = recording()
    factor = changes.get("oversampling", 1)
    for i in range(sweeps):
        writer.log(float(i), "playing", sweep=i)
        writer.wire(float(i), "waveform_dac", "out", b"*TRG\n")
        writer.write_sweep(
            i, command, np.repeat(sensor, factor), np.repeat(drive, factor), 10.0 * i
        )
    return writer.finish()


def test_raw_volts_and_attributes_give_back_the_displacement(tmp_path):
    path = written(tmp_path / "r.h5")
    with h5py.File(path) as f:  # as a stranger would read it
        g = f["entry/sweep_0001"]
        a = g.attrs
        drive = a["gain"] * g["command_v"][...] + a["offset_v"]
        moved = a["polarity"] * (g["sensor_v"][...] - a["zero_v"]) * a["sensitivity_um_per_v"]
        assert g["sensor_v"].attrs["units"] == "V"
    np.testing.assert_allclose(drive, recording()[2], atol=1e-9)
    np.testing.assert_allclose(moved, 0.15 * recording()[2], atol=1e-5)  # float32 volts


def test_every_attribute_of_the_design_is_there(tmp_path):
    with h5py.File(written(tmp_path / "r.h5")) as f:
        for name in ("sample_rate", "gain", "offset_v", "sensitivity_um_per_v", "polarity",
                     "zero_v", "condition", "repeat", "history", "start_time", "origin"):
            assert name in f["entry/sweep_0002"].attrs
        assert f["entry/protocol_text"][()].decode() == "x = 'ü'"


def test_the_default_plot_is_found_the_nexus_way(tmp_path):
    with h5py.File(written(tmp_path / "r.h5")) as f:
        assert f.attrs["NX_class"] == "NXroot"
        entry = f[f.attrs["default"]]
        assert entry.attrs["NX_class"] == "NXentry"
        plot = entry[entry.attrs["default"]]
        assert plot.attrs["NX_class"] == "NXdata"
        signal, axis = plot[plot.attrs["signal"]], plot[plot.attrs["axes"][0]]
        assert signal.shape == axis.shape
        assert signal.attrs["units"] == "um"
        assert axis.attrs["units"] == "V"


def test_a_reader_gets_back_what_was_written(tmp_path):
    run = Run(written(tmp_path / "r.h5"))
    first, second = run.sweeps()
    assert (first.condition, first.repeat, first.history, first.origin) == (
        "0-65", 1, "virgin", "SIMULATED",
    )
    assert second.start_time == 10.0
    assert first.details == {"lower_v": 0.0, "upper_v": 65.0, "cycles": 2}
    assert first.displacement_um[0] == 0.0
    np.testing.assert_array_equal(first.command_v, recording()[0])
    assert [e["event"] for e in run.events()] == ["playing", "playing"]
    assert run.instruments()["waveform_dac"]["settings"] == {"load": "INF"}
    assert run.complete


def test_an_oversampled_channel_is_stored_raw_and_decimated_on_reading(tmp_path):
    writer = RunWriter(tmp_path / "r.h5", HEADER, [header_of("sweep_0001", oversampling=10)])
    command, _, drive = recording()
    t = np.arange(10_000) / 50_000
    slow = 0.3 * np.sin(2 * np.pi * 20 * t)
    alias = 0.1 * np.sin(2 * np.pi * 12_000 * t)  # above the 2.5 kHz that 5 kSa/s can show
    writer.write_sweep(0, command, slow + alias, np.repeat(drive, 10), 0.0)
    path = writer.finish()
    with h5py.File(path) as f:
        np.testing.assert_allclose(f["entry/sweep_0001/sensor_v"][...], slow + alias, atol=1e-6)
    (sweep,) = Run(path).sweeps()
    expected = 0.3 * np.sin(2 * np.pi * 20 * np.arange(1000) / 5000)
    np.testing.assert_allclose(sweep.sensor_v[20:-20], expected[20:-20], atol=1e-3)


def test_a_run_is_never_overwritten(tmp_path):
    path = written(tmp_path / "r.h5")
    before = path.read_bytes()
    with pytest.raises(BenchError):
        RunWriter(path, HEADER, [header_of("sweep_0001")])
    assert path.read_bytes() == before


def test_what_was_not_played_is_left_out_and_said(tmp_path):
    writer = RunWriter(tmp_path / "r.h5", HEADER,
                       [header_of("sweep_0001"), header_of("sweep_0002")])
    command, sensor, drive = recording()
    writer.write_sweep(0, command, sensor, drive, 0.0)
    run = Run(writer.finish())
    assert run.sweep_names == ["sweep_0001"]
    assert not run.complete
    _, found = verify(run.path)
    assert any("1 of 2" in v.text for v in found)


KILLED = """
import sys, time
from pathlib import Path
sys.path.insert(0, {here!r})
from test_run_file import HEADER, header_of, recording
from piezo_rig.run_file.writer import RunWriter
names = [f"sweep_{{i + 1:04d}}" for i in range(50)]
w = RunWriter(Path({path!r}), HEADER, [header_of(n) for n in names])
c, s, d = recording()
for i in range(50):
    w.write_sweep(i, c, s, d, float(i))
    print(i, flush=True)
    time.sleep(0.02)
"""


def test_a_killed_writer_loses_nothing_that_was_stored(tmp_path):
    path = tmp_path / "r.h5"
    program = KILLED.format(here=str(Path(__file__).parent), path=str(path))
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as p:
        assert p.stdout is not None
        stored = -1
        while stored < 7:
            stored = int(p.stdout.readline())
        os.kill(p.pid, signal.SIGKILL)
        p.wait()
    assert recover(tmp_path) == [path]
    assert not part_path(path).exists()
    sweeps = Run(path).sweeps()
    assert len(sweeps) >= stored + 1
    for s in sweeps:
        np.testing.assert_allclose(s.sensor_v, recording()[1], atol=1e-6)


def test_a_part_that_is_still_being_written_is_left_alone(tmp_path):
    writer = RunWriter(tmp_path / "r.h5", HEADER, [header_of("sweep_0001")])
    assert recover(tmp_path) == []
    assert writer.part.exists()
    writer.release()


def test_verify_finds_nothing_wrong_with_a_good_run(tmp_path):
    names, found = verify(written(tmp_path / "r.h5"))
    assert names == ["sweep_0001", "sweep_0002"]
    assert found == []


def spoil(tmp_path: Path, how) -> list[str]:
    path = written(tmp_path / "r.h5")
    with h5py.File(path, "r+") as f:
        how(f)
    return [v.text for v in verify(path)[1] if v.fault]


def test_verify_finds_missing_values(tmp_path):
    def how(f):
        f["entry/sweep_0002/sensor_v"][17:20] = np.nan

    assert any("3 values missing, first at sample 17" in t for t in spoil(tmp_path, how))


def test_verify_finds_a_saturated_sensor(tmp_path):
    def how(f):
        data = f["entry/sweep_0001/sensor_v"]
        data[...] = np.maximum(data[...], -0.2)

    assert any("saturated" in t for t in spoil(tmp_path, how))


def test_verify_finds_a_monitor_that_disagrees_with_the_command(tmp_path):
    def how(f):
        f["entry/sweep_0001/drive_monitor_v"][500:600] -= 5.0

    assert any("drive monitor" in t for t in spoil(tmp_path, how))


def test_verify_finds_a_clock_that_runs_backwards(tmp_path):
    def how(f):
        f["entry/sweep_0002"].attrs["start_time"] = -1.0

    assert any("not after" in t for t in spoil(tmp_path, how))


def test_verify_finds_flipped_bits_by_checksum(tmp_path):
    path = written(tmp_path / "r.h5")
    with h5py.File(path) as f:
        info = f["entry/sweep_0001/sensor_v"].id.get_chunk_info(0)
    data = bytearray(path.read_bytes())
    data[info.byte_offset + info.size // 2] ^= 0xFF
    path.write_bytes(data)
    assert any("damaged" in v.text for v in verify(path)[1] if v.fault)


def test_a_newer_schema_is_one_clear_error(tmp_path):
    path = written(tmp_path / "r.h5")
    with h5py.File(path, "r+") as f:
        f["entry"].attrs["schema_version"] = 99
    with pytest.raises(InputError) as caught:
        Run(path)
    assert caught.value.code == "run-newer"


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> bytes:
    return written(tmp_path_factory.mktemp("good") / "r.h5").read_bytes()


@settings(max_examples=30, derandomize=True, deadline=None)
@given(data=st.data())
def test_damage_anywhere_is_a_clear_error_or_a_correct_reading(good, tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("damaged")
    spoiled = bytearray(good)
    if data.draw(st.booleans()):
        spoiled = spoiled[: data.draw(st.integers(0, len(good)))]
    else:
        for _ in range(data.draw(st.integers(1, 20))):
            spoiled[data.draw(st.integers(0, len(good) - 1))] = data.draw(st.integers(0, 255))
    path = folder / "r.h5"
    path.write_bytes(spoiled)
    try:
        Run(path).sweeps()
        verify(path)
    except PiezoRigError as error:
        assert error.exit_status == 2
    finally:
        shutil.rmtree(folder)


def test_a_sweep_that_would_not_fit_is_refused_while_the_run_can_still_be_closed(
    tmp_path, monkeypatch
):
    writer = RunWriter(tmp_path / "r.h5", HEADER,
                       [header_of("sweep_0001"), header_of("sweep_0002")])
    command, sensor, drive = recording()
    writer.require_room(0)
    writer.write_sweep(0, command, sensor, drive, 0.0)

    class Usage:
        free = 1_000_000

    monkeypatch.setattr("shutil.disk_usage", lambda _: Usage)
    with pytest.raises(BenchError) as caught:
        writer.require_room(1)
    assert caught.value.code == "disk-full"
    assert Run(writer.finish()).sweep_names == ["sweep_0001"]


def test_a_full_disk_is_named_and_what_was_stored_is_kept(tmp_path, monkeypatch):
    writer = RunWriter(tmp_path / "r.h5", HEADER,
                       [header_of("sweep_0001"), header_of("sweep_0002")])
    command, sensor, drive = recording()
    writer.write_sweep(0, command, sensor, drive, 0.0)

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("piezo_rig.run_file.writer.sync", full)
    with pytest.raises(BenchError) as caught:
        writer.write_sweep(1, command, sensor, drive, 1.0)
    assert caught.value.code == "disk-full"
    assert str(writer.part) in caught.value.remedy
    monkeypatch.undo()
    writer.release()
    (run,) = recover(tmp_path)
    assert Run(run).sweep_names[0] == "sweep_0001"
