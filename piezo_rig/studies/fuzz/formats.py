"""The formats that are read from files, who reads them, and good files to begin with."""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from piezo_rig.errors import InputError
from piezo_rig.resources import shipped_folder
from piezo_rig.studies.fuzz.hostile_h5 import HOSTILE, write_hostile, write_plain


@dataclass(frozen=True)
class Format:
    """One format.

    Attributes
    ----------
    suffix : of its files, with the dot
    seeds : makes good (or deliberately hostile) files, given a folder to work in
    read : reads one; PiezoRigError is the only way in which it may fail
    words : words of the format, where it is text
    share : of the inputs of a campaign, relative to the others
    """

    suffix: str
    seeds: Callable[[Path], list[bytes]]
    read: Callable[[Path], None]
    words: tuple[bytes, ...] = ()
    share: float = 1.0


# ------------------------------------------------------------------------------- recordings


def _table() -> np.ndarray:
    t = np.arange(40) * 1e-3
    drive = 30 * (1 - np.cos(2 * np.pi * t / 0.04))
    return np.column_stack([t, (drive - 75) / 7.5, -0.01 * drive, drive])


def _csv_seeds(folder: Path) -> list[bytes]:
    seeds = []
    for names, columns, separator, decimal in (
        ("time_s,drive_v,displacement_um", (0, 3, 2), ",", "."),
        ("time_s,command_v,sensor_v,drive_monitor_v", (0, 1, 2, 3), ",", "."),
        ("Time (s),Command V,Sensor V", (0, 1, 2), ";", ","),
        ("time_s,drive_v", (0, 3), "\t", "."),
    ):
        rows = [separator.join(f"{v:.6f}".replace(".", decimal) for v in row)
                for row in _table()[:, columns]]
        seeds.append("\n".join([names.replace(",", separator), *rows, ""]).encode())
    return [*seeds, *_exported("csv", folder)]


def _exported(format: str, folder: Path) -> list[bytes]:
    """What `piezo-rig export` writes of a small run."""
    from piezo_rig.run_file.exporters import export_run
    from piezo_rig.run_file.reader import Run

    run = Run(write_plain(folder / f"to_{format}.h5", 2))
    files = export_run(run, format, folder / f"exported.{format}.d").files
    return [path.read_bytes() for path in files]


def _lvm_seeds(folder: Path) -> list[bytes]:
    table, seeds = _table(), []
    for x_columns, decimal in (("One", "."), ("No", ","), ("Multi", ".")):
        columns = {"One": (0, 1, 2), "No": (1, 2), "Multi": (0, 1, 0, 2)}[x_columns]
        rows = ["\t".join(f"{v:.6f}" for v in row).replace(".", decimal)
                for row in table[:, columns]]
        head = (
            "LabVIEW Measurement\t\r\nWriter_Version\t2\r\nReader_Version\t2\r\nSeparator\tTab\r\n"
            f"Decimal_Separator\t{decimal}\r\nMulti_Headings\tYes\r\nX_Columns\t{x_columns}\r\n"
            "Time_Pref\tRelative\r\nDate\t2011/03/04\r\nTime\t10:20:30,25\r\n"
            "***End_of_Header***\t\r\n\t\r\n"
        )
        segment = (
            "Channels\t2\t\r\nSamples\t40\t40\r\nDate\t2011/03/04\t2011/03/04\r\n"
            "Time\t10:20:30.25\t10:20:30.25\r\nX_Dimension\tTime\tTime\r\nX0\t0.0\t0.0\r\n"
            "Delta_X\t0.001000\t0.001000\r\n***End_of_Header***\t\t\r\n"
            "X_Value\tCommand\tSensor\tComment\r\n"
        )
        seeds.append((head + segment + "\r\n".join(rows) + "\r\n").encode("cp1252"))
    return [*seeds, seeds[0] + seeds[0][seeds[0].index(b"Channels") :]]


def _tdms_seeds(folder: Path) -> list[bytes]:
    from nptdms import ChannelObject, TdmsWriter

    seeds = []
    for kind in (np.float64, np.float32, np.int16):
        path = folder / "seed.tdms"
        table = (_table() * (1000 if kind is np.int16 else 1)).astype(kind)
        said = {"wf_increment": 0.001, "wf_start_offset": 0.0, "unit_string": "V",
                "wf_start_time": np.datetime64("2012-05-06T07:08:09")}
        with TdmsWriter(str(path)) as writer:
            for part in (slice(0, 25), slice(25, 40)):
                writer.write_segment([
                    ChannelObject("Rig", "Command", table[part, 1], said),
                    ChannelObject("Rig", "Sensor", table[part, 2], said),
                ])
        seeds.append(path.read_bytes())
    return [*seeds, *_exported("tdms", folder)]


def _read_recording(path: Path) -> None:
    from piezo_rig.run_file.imported import write_imported
    from piezo_rig.run_file.importers import ImportOptions, read_recordings

    options = ImportOptions(explicit=frozenset({"sensitivity"}), sensitivity="3")
    found = read_recordings([path], options)
    if sum(s.samples for s in found.sweeps) < 5000:
        run = path.with_name("imported.h5")
        run.unlink(missing_ok=True)
        _read_run(write_imported(found.sweeps, run, found.assumptions))


# ------------------------------------------------------------------------------------- runs


def _h5_seeds(folder: Path) -> list[bytes]:
    seeds = []
    for libver in ("earliest", ("earliest", "v110"), "latest"):
        for sweeps in (1, 2):
            seeds.append(write_plain(folder / "plain.h5", sweeps, libver=libver).read_bytes())
    for name in HOSTILE:
        path = write_hostile(name, folder / "hostile.h5")
        if path.stat().st_size < 1_000_000:
            seeds.append(path.read_bytes())
    return seeds


def _read_run(path: Path) -> None:
    from piezo_rig.commands.show import execute
    from piezo_rig.run_file.reader import Run
    from piezo_rig.run_file.verify import verify

    names, found = verify(path)
    run = Run(path)
    bad = {v.sweep for v in found if v.fault}
    good = []
    for name in names:
        if name not in bad:
            good.append(name)
    for _, sweep in run.each(good):
        if isinstance(sweep, InputError):
            raise AssertionError(f"verify let pass what cannot be read: {sweep.what}")
        _ = sweep.drive_v, sweep.displacement_um, sweep.time_s
    with contextlib.suppress(InputError):
        execute(argparse.Namespace(run=str(path), log=True))


def _transcript_seeds(folder: Path) -> list[bytes]:
    """The transcript of a short run of the simulated bench."""
    from piezo_rig.run_file.reader import Run

    return [Run(_tiny_run(folder)).wire_transcript()]


def _tiny_run(folder: Path) -> Path:
    from dataclasses import replace

    from drivers.clock import VirtualClock
    from piezo_rig.bench import open_bench
    from piezo_rig.config import load_rig
    from piezo_rig.config.toml_text import Document
    from piezo_rig.protocol import build_plan
    from piezo_rig.protocol.protocol_file import parse_protocol
    from piezo_rig.runner import Wire, play

    path = folder / "tiny.h5"
    if path.exists():
        return path
    rig, wire = load_rig(), Wire()
    text = (
        'schema = "piezo-rig/protocol/1"\nsample_rate = 1000\n[[condition]]\nname = "a"\n'
        'waveform = "triangle"\nlower_v = 0\nupper_v = 6\nfrequency_hz = 50\ncycles = 2\n'
    )
    with open_bench(replace(rig, recovery_s=0.0), lambda question: True, wire,
                    VirtualClock()) as bench:
        plan = build_plan(parse_protocol(Document(text, "tiny", "protocol")), bench.rig)
        return play(plan, bench, path, wire)


def _replay_transcript(path: Path) -> None:
    import h5py

    from piezo_rig.replay import replay
    from piezo_rig.run_file.reader import Run

    run = _tiny_run(path.parent)
    with h5py.File(run, "r+") as f:
        del f["entry/wire_transcript"]
        f["entry/wire_transcript"] = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    replay(Run(run))


# ------------------------------------------------------------------------------------ texts


def _shipped(kind: str, suffix: str) -> list[bytes]:
    return [p.read_bytes() for p in sorted(shipped_folder(kind).glob("*" + suffix))]


def _read_protocol(path: Path) -> None:
    from piezo_rig.config import load_rig
    from piezo_rig.protocol import build_plan, load_protocol

    plan = build_plan(load_protocol(path), load_rig())
    _ = plan.hash, plan.samples, plan.duration_s, plan.file_bytes


def _read_rig(path: Path) -> None:
    from piezo_rig.bench import plant_config
    from piezo_rig.config import load_rig
    from piezo_rig.protocol import build_plan, load_protocol

    rig = load_rig(str(path))
    if rig.simulated:
        plant_config(rig)
    build_plan(load_protocol(shipped_folder("protocols") / "quick_look.toml"), rig)


def _read_calibration(path: Path) -> None:
    from piezo_rig.config.calibration import load_amplifier, load_interferometer

    with contextlib.suppress(InputError):
        load_amplifier(path)
    load_interferometer(path, "exact")


def _model_seeds(folder: Path) -> list[bytes]:
    from piezo_rig.causes import load_model
    from piezo_rig.chain import save_model

    small = []
    for path in sorted(shipped_folder("calibration").glob("*.json")):
        save_model(load_model(path), folder / "seed.json")
        small.append((folder / "seed.json").read_bytes())
    stage = (
        b'{"id": "creep", "parameters": {"rate_per_decade": {"value": 0.01, "unit": "1"}}},'
    )
    return [*small, *(s.replace(b'"stages": [', b'"stages": [' + stage, 1) for s in small)]


def _read_model(path: Path) -> None:
    from piezo_rig.causes import load_model
    from piezo_rig.model_export import c_source, write_csv_tables

    model = load_model(path)
    with contextlib.suppress(InputError):
        c_source(model, "fuzzed", 5000.0)
    write_csv_tables(model, path.with_suffix(".csv"))
    time = 1e-3 * np.arange(60, dtype=np.float64)
    drive = np.interp(time, [0, 0.02, 0.03, 0.06], [0.0, 60.0, 20.0, 75.0]).astype(np.float64)
    for history in ("virgin", "unknown"):
        model.simulate(time, drive, history=history)


_TOML = (b"[", b"]", b"[[", b"]]", b"=", b"\"", b"'''", b"#", b"{", b"}", b".", b"1979-05-27",
         b"true", b"\\u0000", b"[[condition]]\n", b"a.b.c = 1\n")  # fmt: skip

FORMATS: dict[str, Format] = {
    "lvm": Format(".lvm", _lvm_seeds, _read_recording, (
        b"***End_of_Header***", b"***Start_Special***\n", b"***End_Special***\n", b"X_Columns\t",
        b"Multi", b"No", b"One", b"Separator\tComma\n", b"Decimal_Separator\t,\n", b"\t", b"\r\n",
        b"Channels\t", b"Delta_X\t", b"X0\t", b"Samples\t", b"Date\t", b"Time\t", b"X_Value\t",
    ), 1.5),
    "tdms": Format(".tdms", _tdms_seeds, _read_recording, (), 1.5),
    "mat": Format(".mat", lambda folder: _exported("mat", folder), _read_recording),
    "csv": Format(".csv", _csv_seeds, _read_recording, (
        b"time_s", b"drive_v", b"displacement_um", b"command_v", b"sensor_v", b",", b";", b"\t",
        b"\"", b"\n", b"#", b"nan", b"\xef\xbb\xbf", b"\xff\xfe", b"\0",
        b"# piezo-rig/sweep/1\n", b"# gain = ", b"# history = ", b"# repeat = ", b"= [[",
    ), 1.5),
    "h5": Format(".h5", _h5_seeds, _read_run, (), 2.0),
    "transcript": Format(".bin", _transcript_seeds, _replay_transcript, (), 0.3),
    "protocol": Format(".toml", lambda _: _shipped("protocols", ".toml"), _read_protocol, (
        *_TOML, b'waveform = "triangle"\n', b'"sine"', b'"hold"', b'"steps"', b'"turning-points"',
        b'"blank"', b'"sequence"', b"lower_v = ", b"upper_v = ", b"cycles = ", b"frequency_hz = ",
        b"slew_v_per_s = ", b"duration_s = ", b"levels_v = ", b"points_v = ", b"hold_s = ",
        b"repeats = ", b"[[condition.segments]]\n", b"sample_rate = ",
    )),
    "rig": Format(".toml", lambda _: _shipped("configs", ".toml"), _read_rig, (
        *_TOML, b"[plant]\n", b"[plant.creep]\n", b"on = true\n", b"[limits]\n", b"[digitizer]\n",
        b"oversampling = ", b"calibration = ", b"sensitivity = ", b"capacitance_f = ",
    )),
    "calibration": Format(".toml", lambda _: _shipped("calibration", ".toml"), _read_calibration, (
        *_TOML, b"gain = ", b"offset_v = ", b"printed_um_per_v = ", b"exact_um_per_v = ",
    ), 0.8),
    "model": Format(".json", _model_seeds, _read_model, (
        b"{", b"}", b"[", b"]", b"null", b"NaN", b"Infinity", b"\"value\": ", b"\"elements\": ",
        b"\"id\": \"creep\"", b"\"unit\": ", b"\"ci95\": ", b"\\ud800",
    )),
}  # fmt: skip


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """What is read here prints into nothing."""
    with open(os.devnull, "w") as nothing, contextlib.redirect_stdout(nothing):
        yield
