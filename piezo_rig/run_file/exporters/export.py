"""Sweep by sweep out of a run, each with its settings, into files of one format."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from piezo_rig.errors import BenchError, InputError
from piezo_rig.run_file.importers.said import MARK, Scalar
from piezo_rig.run_file.layout import DETAIL_PREFIX
from piezo_rig.run_file.reader import Run
from piezo_rig.run_file.sweep import FloatArray, Sweep

FORMATS = ("csv", "tdms", "mat")
WALL_CLOCK_FROM_S = 1e9  # a later start counts from 1970 by itself


@dataclass(frozen=True)
class Exported:
    """What was written, and what was not.

    Attributes
    ----------
    files : in the order of the sweeps
    left_out : sentences
    """

    files: list[Path] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Piece:
    """One sweep, ready to be written.

    Attributes
    ----------
    settings : what makes physics of its volts, and where it stood in the run
    wall_s : seconds since 1970 (UTC) when it began, as far as the run knows
    """

    sweep: Sweep
    settings: dict[str, Scalar]
    wall_s: float

    @property
    def channels(self) -> dict[str, FloatArray]:
        """Volts by the names of a run."""
        own = {"command_v": self.sweep.command_v, "sensor_v": self.sweep.sensor_v}
        if self.sweep.drive_monitor_v is not None:
            own["drive_monitor_v"] = self.sweep.drive_monitor_v
        return own


def export_run(run: Run, format: str, out: Path) -> Exported:
    """Write the sweeps of a run.

    Parameters
    ----------
    run : superseded sweeps, and those that cannot be read, are left out
    format : one of `FORMATS`
    out : for ``mat`` the file; for ``csv`` and ``tdms`` a folder, which gets a file for every
        sweep, or, for a run of one sweep, a file of that extension

    Raises
    ------
    InputError : no sweep to be read, or one file for several sweeps
    BenchError : the disk refuses (exit 4)
    """
    left_out = [f"{name}: superseded by {by}" for name, by in run.superseded.items()]
    if format == "mat":
        from piezo_rig.run_file.exporters.mat_file import write_mat

        pieces = list(_pieces(run, left_out))
        _refuse_nothing(run, pieces)
        with _Disk(out):
            out.parent.mkdir(parents=True, exist_ok=True)
            write_mat(out, run, pieces)
        return Exported([out], left_out)
    if format == "csv":
        from piezo_rig.run_file.exporters.csv_file import write_csv as write
    else:
        from piezo_rig.run_file.exporters.tdms_file import write_tdms as write
    suffix = f".{format}"
    one = out.suffix.lower() == suffix and not out.is_dir()
    if one and len(run.active_names) > 1:
        raise InputError(
            "export-many", f"{run.path} holds {len(run.active_names)} sweeps, and {out} is one "
            "file", f"a {suffix} file holds one sweep", f"name a folder: --out {out.stem}",
        )
    files: list[Path] = []
    with _Disk(out):
        (out.parent if one else out).mkdir(parents=True, exist_ok=True)
        for piece in _pieces(run, left_out):
            path = out if one else out / (file_stem(piece.sweep) + suffix)
            write(path, piece)
            files.append(path)
    _refuse_nothing(run, files)
    return Exported(files, left_out)


def file_stem(sweep: Sweep) -> str:
    """``0004 0-65 test 2``: in the order of names, files are in the order of time."""
    number = sweep.name.removeprefix("sweep_")
    condition = "".join(c if c.isalnum() or c in "-_.,+ " else "_" for c in sweep.condition)
    return f"{number} {condition.strip()[:100]} test {sweep.repeat}"


def _pieces(run: Run, left_out: list[str]) -> Iterator[Piece]:
    """Sweep by sweep, as long as they can be read; why not, for the others."""
    mark = hashlib.sha256(
        "".join(run.texts.get(k, "") for k in ("title", "start_time", "plan_hash")).encode()
    ).hexdigest()[:16]
    before = ""
    for name, sweep in run.each():
        if isinstance(sweep, InputError):
            left_out.append(f"{name}: {sweep.what.removeprefix(f'{run.path}: {name}: ')}")
            before = ""
            continue
        yield Piece(sweep, _settings(sweep, mark, before), _wall_s(run, sweep))
        before = name


def _settings(sweep: Sweep, mark: str, before: str) -> dict[str, Scalar]:
    """What `importers.said` reads back."""
    return {
        "schema": MARK,
        "run": mark,
        "sweep": sweep.name,
        "follows": before if sweep.history == "carried" else "",
        "origin": sweep.origin,
        "condition": sweep.condition,
        "repeat": sweep.repeat,
        "history": sweep.history,
        "start_time": sweep.start_time,
        "sample_rate": sweep.sample_rate,
        "gain": sweep.gain,
        "offset_v": sweep.offset_v,
        "sensitivity_um_per_v": sweep.sensitivity_um_per_v,
        "polarity": sweep.polarity,
        "zero_v": sweep.zero_v,
        **{DETAIL_PREFIX + key: value for key, value in sweep.details.items()},
    }


def _wall_s(run: Run, sweep: Sweep) -> float:
    """When the sweep began by the wall clock; the run's own clock where that is not known."""
    if sweep.start_time > WALL_CLOCK_FROM_S:
        return sweep.start_time
    try:
        begun = datetime.fromisoformat(run.texts.get("start_time", ""))
    except ValueError:
        return sweep.start_time
    if begun.tzinfo is None:
        begun = begun.replace(tzinfo=UTC)
    return begun.timestamp() + sweep.start_time - run.clock_start


def times_s(sweep: Sweep) -> FloatArray:
    """Seconds of every sample on the run's clock, shape (n,)."""
    return np.asarray(sweep.start_time + sweep.time_s)


def _refuse_nothing(run: Run, written: Sequence[object]) -> None:
    if not written:
        raise InputError(
            "no-data", f"{run.path}: no sweep to be exported",
            "nothing was played, the run is not closed yet, or the file is damaged",
            "see 'piezo-rig verify'; a run that is being recorded: 'piezo-rig watch'",
        )


class _Disk:
    """Turns what a disk can refuse into one error."""

    def __init__(self, out: Path) -> None:
        self.out = out

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, OSError):
            raise BenchError(
                "disk", f"could not write {self.out}: {error.strerror or error}",
                "the disk is full, the name is taken, or the folder is not yours to write",
                "give another --out",
            ) from None
