"""Checks a run: layout, checksums, completeness, units, clocks, calibration, drive monitor.

Each check says for one sweep, or for the run, what is wrong; a sweep with a
fault may not be used, one with a warning may.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from piezo_rig.errors import InputError
from piezo_rig.run_file.layout import PART_SUFFIX, REQUIRED_ATTRIBUTES, UNITS
from piezo_rig.run_file.reader import Run, decimate

# The monitor sees the stack, the command says what it should be: gain and offset of the
# amplifier (0.5 %), the digitizer's range, and the amplifier's lag at the highest slew.
MONITOR_TOLERANCE_V = 0.75
FLAT_SAMPLES = 8


@dataclass(frozen=True)
class Verdict:
    """What was found; ``sweep`` is empty for the run as a whole."""

    sweep: str
    fault: bool
    text: str


def verify(path: Path) -> tuple[list[str], list[Verdict]]:
    """Check one run file.

    Returns
    -------
    names of all sweeps, and everything that was found, in the order of the file

    Raises
    ------
    InputError : not a run at all
    """
    run = Run(path)
    found: list[Verdict] = []
    if path.name.endswith(PART_SUFFIX):
        return _unfinished(run)
    if not run.complete:
        found.append(Verdict("", True, _incomplete(run)))
    for key in ("protocol_text", "plan_hash", "rig_config", "software_version"):
        if run.origin != "IMPORTED" and key not in run.texts:
            found.append(Verdict("", True, f"{key} is missing"))
    previous = -np.inf
    with run._open() as entry:
        for name in run.sweep_names:
            problems = _check_sweep(entry[name], run.origin)
            found += [Verdict(name, fault, text) for fault, text in problems]
            start = float(entry[name].attrs.get("start_time", np.nan))
            if run.origin != "IMPORTED" and not start > previous:
                text = f"starts at {start:g} s, not after the one before"
                found.append(Verdict(name, True, text))
            previous = start
        for name in _damaged_elsewhere(entry):
            found.append(Verdict("", True, f"{name} cannot be read; it is damaged"))
        if run.origin != "IMPORTED" and "loop" not in entry and run.sweep_names:
            found.append(Verdict("", True, "the default plot (loop) is missing"))
    return run.sweep_names, found


def _unfinished(run: Run) -> tuple[list[str], list[Verdict]]:
    with run._open() as entry:
        valid = np.asarray(entry["recording/n_valid"][...])
    stored = int(np.count_nonzero(valid))
    text = (f"an unfinished recording with {stored} of {valid.size} sweeps; the next 'run' in "
            "this folder recovers it")
    return [], [Verdict("", True, text)]


def _damaged_elsewhere(entry: h5py.Group) -> list[str]:
    """Everything but the sweeps that cannot be read, by name."""
    broken: list[str] = []

    def look(name: str, thing: object) -> None:
        if isinstance(thing, h5py.Dataset) and not name.startswith("sweep_"):
            try:
                thing[()]
                dict(thing.attrs)
            except (OSError, RuntimeError, ValueError, TypeError):
                broken.append(name)

    entry.visititems(look)
    return broken


def _incomplete(run: Run) -> str:
    planned = int(run.attributes.get("planned_sweeps", len(run.sweep_names)))
    return f"{len(run.sweep_names)} of {planned} planned sweeps were played"


def _check_sweep(group: h5py.Group, origin: str) -> list[tuple[bool, str]]:
    a = dict(group.attrs)
    missing = [k for k in REQUIRED_ATTRIBUTES if k not in a]
    if missing:
        return [(True, f"lacks {', '.join(missing)}")]
    problems: list[tuple[bool, str]] = []
    if str(a["origin"]) != origin:
        problems.append((True, f"origin {a['origin']} in a run of origin {origin}"))
    for key in ("sample_rate", "gain", "sensitivity_um_per_v"):
        if not (np.isfinite(a[key]) and a[key] > 0):
            problems.append((True, f"{key} is {a[key]}"))
    if int(a["polarity"]) not in (-1, 1):
        problems.append((True, f"polarity is {a['polarity']}"))
    channels: dict[str, np.ndarray] = {}
    for channel, unit in UNITS.items():
        if channel not in group:
            if channel != "drive_monitor_v":
                problems.append((True, f"{channel} is missing"))
            continue
        dataset = group[channel]
        if str(dataset.attrs.get("units", "")) != unit:
            problems.append((True, f"{channel} is not in {unit}"))
        try:
            channels[channel] = np.asarray(dataset[...], dtype=float)
        except OSError:
            problems.append((True, f"{channel}: the checksum does not match; the data is damaged"))
            continue
        bad = np.flatnonzero(~np.isfinite(channels[channel]))
        if bad.size:
            text = f"{channel}: {bad.size} values missing, first at sample {bad[0]}"
            problems.append((True, text))
    if problems or "sensor_v" not in channels or "command_v" not in channels:
        return problems
    return _check_values(a, channels)


def _check_values(a: dict[str, Any], channels: dict[str, np.ndarray]) -> list[tuple[bool, str]]:
    problems: list[tuple[bool, str]] = []
    factor = int(a.get("oversampling", 1))
    command, sensor = channels["command_v"], channels["sensor_v"]
    if sensor.size != command.size * factor:
        return [(True, f"sensor_v has {sensor.size} samples, expected {command.size * factor}")]
    drive = float(a["gain"]) * command + float(a["offset_v"])
    if abs(float(a["zero_v"]) - sensor[0]) > 1e-6 * max(1.0, abs(sensor[0])) and (
        a["history"] != "carried" and a["origin"] != "IMPORTED"
    ):
        text = f"zero_v is {a['zero_v']:.6g} V, the first sample {sensor[0]:.6g} V"
        problems.append((True, text))
    for word, values in (("largest", sensor), ("smallest", -sensor)):
        top = values.max()
        if np.ptp(sensor) > 0 and np.ptp(drive) > 0:
            flat = _longest_run(values >= top)
            if flat >= FLAT_SAMPLES * factor and _moves(drive, values, top, factor):
                problems.append((
                    True, f"sensor_v stays at its {word} value for {flat} samples: saturated",
                ))
    monitor = channels.get("drive_monitor_v")
    if monitor is not None and monitor.size == sensor.size:
        monitor = decimate(monitor, factor)
        # The amplifier's lag and a sample of delay are not faults; a wrong level is.
        slew = np.abs(np.gradient(drive))
        worst = np.abs(monitor - drive) - 2.0 * slew
        index = int(worst.argmax())
        if worst[index] > MONITOR_TOLERANCE_V:
            problems.append((
                True, f"the drive monitor reads {monitor[index]:.2f} V where the command asks for "
                f"{drive[index]:.2f} V (sample {index})",
            ))
    return problems


def _longest_run(mask: np.ndarray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return int((edges[1::2] - edges[::2]).max()) if edges.size else 0


def _moves(drive: np.ndarray, values: np.ndarray, top: float, factor: int) -> bool:
    """Whether the drive moves while the sensor stands still at its extreme."""
    at = np.flatnonzero(values[::factor] >= top)
    return at.size > 1 and float(np.ptp(drive[at])) > 0.02 * float(np.ptp(drive))


def usable(path: Path) -> set[str]:
    """Names of the sweeps of a run that may be used.

    Raises
    ------
    InputError : not a run
    """
    names, found = verify(path)
    return set(names) - {v.sweep for v in found if v.fault and v.sweep}


def require_run(path: Path) -> Path:
    """The path, if it is a file at all."""
    if not path.is_file():
        raise InputError(
            "file-missing", f"{path}: no such run", "a slip in the name", "give a run file (.h5)"
        )
    return path
