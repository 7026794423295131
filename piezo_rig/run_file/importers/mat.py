"""Runs that this program wrote as MATLAB files; other .mat files are no recordings.

scipy is kept on a leash: it may take no more memory than the file can justify, and whatever it
raises is one error.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from piezo_rig.errors import InputError
from piezo_rig.run_file.importers.guards import read_bytes, refuse_mislabelled
from piezo_rig.run_file.importers.recording import Column, Recording
from piezo_rig.run_file.importers.said import Said, said_in
from piezo_rig.run_file.importers.words import COMMAND_V, MONITOR_V, SENSOR_V
from piezo_rig.run_file.memory import bounded
from piezo_rig.run_file.sweep import FloatArray

CODE = "import-mat"
MAGIC = b"MATLAB 5.0"
_ROOM, _RATIO = 100_000_000, 64  # bytes: in any case, and for each one of the file
_CHANNELS = (COMMAND_V, SENSOR_V, MONITOR_V)
_WHOLE = ("repeat", "polarity")


def read_mat(path: Path) -> list[Recording]:
    """The sweeps of an exported run, each with the settings that it states.

    Raises
    ------
    InputError : not a file of `piezo_rig.run_file.exporters`, or damaged
    """
    data = read_bytes(path)
    refuse_mislabelled(path, data, own=MAGIC)
    rows = _rows(path, data)
    return [_recording(path, row, number) for number, row in enumerate(rows, start=1)]


def _rows(path: Path, data: bytes) -> list[dict[str, Any]]:
    """The structures of ``sweeps``, field by field."""
    from scipy.io import loadmat

    try:
        with bounded(_ROOM + _RATIO * len(data)), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = loadmat(io.BytesIO(data), variable_names=["sweeps"])["sweeps"]
        if found.dtype.names is None or not found.size or found.size > 20_000:
            raise ValueError("its sweeps are no structures")
        return [{n: row[n] for n in found.dtype.names} for row in found.ravel()]
    except (Exception, MemoryError) as failure:
        raise InputError(
            CODE, f"{path}: cannot be read as an exported run",
            f"another program wrote it, or it is damaged ({_short(failure)})",
            "take a recording as .csv, .tdms or .lvm",
        ) from failure


def _short(failure: BaseException) -> str:
    text = "".join(c if c.isprintable() else "?" for c in str(failure)[:100])
    return text or type(failure).__name__


def _recording(path: Path, row: dict[str, Any], number: int) -> Recording:
    place = f"sweep {number}"
    said = said_in(path, {k: _scalar(k, v) for k, v in row.items()})
    times = _column(path, place, row, "time_s")
    rate = _scalar("sample_rate", row.get("sample_rate"))
    if times is None or not isinstance(rate, float) or not 0 < rate < 1e12:
        raise InputError(CODE, f"{path}: {place} does not say when it was sampled")
    even = bool(np.array_equal(times, np.arange(times.size) / rate))
    values = {"time_s": times} | {
        name: found for name in _CHANNELS
        if (found := _column(path, place, row, name)) is not None and found.size
    }
    if any(v.size != times.size for v in values.values()):
        raise InputError(CODE, f"{path}: {place} has channels of different lengths")
    if even:
        del values["time_s"]
    return Recording(
        path=path, kind="mat", columns=_columns(list(values), said, None if not even else 1 / rate),
        load=_loader(list(values.values())), where=lambda k: f"{place}, sample {k}",
        positional=True, segment=number, said=said,
    )


def _columns(names: Sequence[str], said: Said, step_s: float | None) -> tuple[Column, ...]:
    return tuple(
        Column(
            name, is_time=name == "time_s", stamp=said.start_time, step_s=step_s,
            time_column=None if step_s or name == "time_s" else 0,
        )
        for name in names
    )


def _loader(values: list[FloatArray]) -> Callable[[Sequence[int]], list[FloatArray]]:
    return lambda columns: [values[c].copy() for c in columns]


def _scalar(key: str, value: Any) -> Any:
    """A number or text of MATLAB, both of which are tables there; None for anything else."""
    array = np.asarray(value)
    if array.size == 0 and array.dtype.kind in "US":
        return ""
    if array.size != 1 or array.dtype.kind not in "fiuU":
        return "" if array.size == 0 else None
    found = array.ravel()[0].item()
    if key in _WHOLE and isinstance(found, float) and found == int(found):
        return int(found)
    return float(found) if isinstance(found, int) else found


def _column(path: Path, place: str, row: dict[str, Any], name: str) -> FloatArray | None:
    if name not in row:
        return None
    array = np.asarray(row[name])
    if array.dtype.kind not in "fiu":
        raise InputError(CODE, f"{path}: {place}: {name} holds no numbers")
    return np.ascontiguousarray(array.ravel(), dtype=np.float64)
