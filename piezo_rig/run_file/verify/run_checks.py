"""Everything of a run but its sweeps: whole, with its texts, transcript and default plot."""

from __future__ import annotations

from typing import Any

import h5py
import numpy as np

from piezo_rig.errors import InputError
from piezo_rig.run_file.guarded import HDF5_ERRORS, Budget, Damaged, attributes, child, numbers
from piezo_rig.run_file.reader import SWEEP_PREFIX, Run, read_sweep
from piezo_rig.run_file.sweep import ORIGINS
from piezo_rig.run_file.transcript import records
from piezo_rig.run_file.verify.calibration import Recorded
from piezo_rig.run_file.verify.verdict import Verdict

_TEXTS = ("protocol_text", "plan_hash", "rig_config", "software_version")


def check_run(run: Run, entry: h5py.Group, read: dict[str, dict[str, Any]]) -> list[Verdict]:
    """Faults and notes of the run as a whole; ``read`` holds its sweeps' attributes."""
    faults: list[str] = [why for name, why in run.unreadable.items() if name != "loop"]
    if run.origin not in ORIGINS:
        faults.append(f"origin is {run.origin[:40]!r}, not one of {', '.join(ORIGINS)}")
    faults += _completeness(run)
    if run.origin != "IMPORTED":
        faults += [f"{key} is missing" for key in _TEXTS if key not in run.texts]
        faults += Recorded.of(run).problems
        faults += _transcript(run)
        faults += _instruments(run)
    if run.sweep_names:
        faults += _loop(run, entry, read)
    return [Verdict("", True, text) for text in faults]


def _completeness(run: Run) -> list[str]:
    """As many sweeps as were planned; one that was played again counts once."""
    planned = run.attributes.get("planned_sweeps", len(run.active_names))
    count = len(run.active_names)
    if not run.complete:
        return [f"{count} of {planned} planned sweeps were played"]
    if count != planned:
        there = set(run.sweep_names)
        due = [f"{SWEEP_PREFIX}{i + 1:04d}" for i in range(min(int(planned), 10_000))]
        gone = [n for n in due if n not in there]
        return [
            f"says that it is complete, but {count} of {planned} sweeps are in it"
            + (f"; missing: {', '.join(gone[:5])}" if gone else "")
        ]
    return []


def _instruments(run: Run) -> list[str]:
    try:
        found = run.instruments()
    except InputError:
        return []  # said with the calibration
    return [
        f"the {name} is not among the instruments"
        for name in ("waveform_dac", "digitizer")
        if name not in found and run.texts.get("rig_config")
    ]


def _transcript(run: Run) -> list[str]:
    try:
        data = run.wire_transcript()
        last = 0.0
        for record in records(data):
            if record.direction == "event" and record.data.startswith(b"opened "):
                last = 0.0  # a session begins, before the bench's clock is known
            if not record.time_s >= last:
                return [f"wire_transcript: time runs backwards at {record.time_s:g} s"]
            last = record.time_s
    except InputError as error:
        return [f"wire_transcript: {error.what}"]
    return []


def _loop(run: Run, entry: h5py.Group, read: dict[str, dict[str, Any]]) -> list[str]:
    """The default plot shows the sweep that it says it shows."""
    try:
        loop = child(entry, "loop", h5py.Group)
        if loop is None:
            return ["the default plot (loop) is missing"]
        name = attributes(loop).get("sweep")
        if name not in read:
            return [] if name in run.sweep_names else [f"the default plot is of {name!r}"]
        budget = Budget(run.path)
        shown = numbers(loop, "displacement", budget), numbers(loop, "drive_voltage", budget)
        if shown[0] is None or shown[1] is None:
            return ["the default plot (loop) is empty"]
        try:
            sweep = read_sweep(entry, name, run.path, budget)
        except InputError:
            return []  # said with the sweep
        if read[name]["oversampling"] == 1 and not (
            _same(shown[0], sweep.displacement_um) and _same(shown[1], sweep.drive_v)
        ):
            return [f"the default plot (loop) does not show {name} as it stands in the run"]
    except Damaged as damage:
        return [str(damage)]
    except HDF5_ERRORS as error:
        return [f"loop cannot be read: {type(error).__name__}"]
    return []


def _same(shown: np.ndarray, expected: np.ndarray) -> bool:
    return shown.shape == expected.shape and bool(
        np.allclose(shown, expected, rtol=1e-5, atol=1e-5, equal_nan=True)
    )
