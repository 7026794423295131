"""A run as an xarray dataset: sweeps beside each other over one time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from piezo_rig.errors import InputError
from piezo_rig.run_file.layout import DETAIL_PREFIX
from piezo_rig.run_file.sweep import FloatArray, Sweep

if TYPE_CHECKING:
    import xarray

    from piezo_rig.run_file.reader import Run

# name, unit, long name, how a sweep gives it
_CHANNELS: tuple[tuple[str, str, str, Callable[[Sweep], FloatArray | None]], ...] = (
    ("drive_v", "V", "drive on the actuator", lambda s: s.drive_v),
    ("displacement_um", "um", "displacement from the sweep's zero", lambda s: s.displacement_um),
    ("command_v", "V", "waveform DAC", lambda s: s.command_v),
    ("sensor_v", "V", "sensor's analog output", lambda s: s.sensor_v),
    ("drive_monitor_v", "V", "voltage measured on the stack", lambda s: s.drive_monitor_v),
)
_COORDINATES = {
    "condition": "", "repeat": "", "history": "", "start_time": "s", "samples": "",
    "gain": "V/V", "offset_v": "V", "sensitivity_um_per_v": "um/V", "polarity": "", "zero_v": "V",
}
_ABOUT = ("title", "start_time", "operator", "plan_hash", "software_version", "git_revision")


def to_xarray(run: Run, names: Sequence[str] | None = None) -> xarray.Dataset:
    """See `Run.to_xarray`."""
    try:
        import xarray
    except ImportError:
        raise InputError(
            "extra-missing", "xarray is not installed", "it comes with the extra 'xarray'",
            "pip install 'piezo-rig[xarray]'",
        ) from None
    sweeps = run.sweeps(names)
    time = _time(run, sweeps)
    data: dict[str, Any] = {}
    for name, unit, long_name, get in _CHANNELS:
        rows = [get(s) for s in sweeps]
        if all(row is None for row in rows):
            continue
        filled = np.full((len(sweeps), time.size), np.nan)
        for k, row in enumerate(rows):
            if row is not None:
                filled[k, : row.size] = row
        data[name] = (("sweep", "time"), filled, {"units": unit, "long_name": long_name})
    coordinates: dict[str, Any] = {
        "sweep": [s.name for s in sweeps],
        "time": ("time", time, {"units": "s", "long_name": "time from a sweep's first sample"}),
    }
    for name, unit in _COORDINATES.items():
        values = [getattr(s, name) for s in sweeps]
        coordinates[name] = ("sweep", values, {"units": unit} if unit else {})
    for key in sorted({k for s in sweeps for k in s.details}):
        if all(key in s.details for s in sweeps):
            coordinates[DETAIL_PREFIX + key] = ("sweep", [s.details[key] for s in sweeps])
    about = {key: run.texts[key] for key in _ABOUT if run.texts.get(key)}
    about |= {"origin": run.origin, "source": str(run.path)}
    return xarray.Dataset(data, coordinates, about)


def _time(run: Run, sweeps: Sequence[Sweep]) -> FloatArray:
    """Times of the longest sweep, which are those of all others as far as they go."""
    rates = sorted({s.sample_rate for s in sweeps})
    even = all(s.sample_times_s is None for s in sweeps)
    if not sweeps or (len(sweeps) > 1 and (len(rates) > 1 or not even)):
        how = f"at {', '.join(f'{r:g}' for r in rates)} samples/s" if even else "unevenly"
        raise InputError(
            "no-common-time",
            f"{run.path}: " + (f"its sweeps were sampled {how}" if sweeps else "holds no sweep"),
            "recordings of different rates were imported together" if sweeps else
            "nothing was played", "name sweeps of one rate: Run.to_xarray([...])",
        )
    return max(sweeps, key=lambda s: s.samples).time_s
