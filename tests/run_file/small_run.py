"""A run that nobody played: a few sweeps of different lengths, made of numbers."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from piezo_rig.run_file.imported import write_imported
from piezo_rig.run_file.sweep import Sweep

RATE = 2000.0


def sweep(number, condition, repeat, upper_v, **changes):
    """A triangle with a displacement that lags it; volts as a digitizer of single precision."""
    samples = 400 + 100 * number
    phase = np.arange(samples) / 200.0 % 2.0
    command = -10.0 + upper_v / 7.5 * np.minimum(phase, 2.0 - phase)
    rng = np.random.default_rng(number)
    moved = 0.13 * (7.5 * command + 75.0) + 0.3 * np.sin(np.pi * phase)
    sensor = np.float32(0.4 - moved / 3.87 + 1e-4 * rng.normal(size=samples)).astype(float)
    made = Sweep(
        name=f"sweep_{number:04d}", command_v=command, sensor_v=sensor, sample_rate=RATE,
        gain=7.5, offset_v=75.0, sensitivity_um_per_v=3.87, polarity=-1, zero_v=float(sensor[0]),
        condition=condition, repeat=repeat, history="virgin", start_time=31.0 + 10.123 * number,
        origin="IMPORTED", drive_monitor_v=np.float32(7.5 * command + 75.0).astype(float),
        details={"lower_v": 0.0, "upper_v": upper_v, "waveform": "triangle"},
    )
    return made.with_(**changes)


def sweeps():
    return [
        sweep(1, "0-65", 1, 65.0),
        sweep(2, "steps 1/2", 1, 40.0, history="carried", sensitivity_um_per_v=15.48),
        sweep(3, "0-65", 2, 65.0),
        sweep(4, "0-65", 3, 65.0, drive_monitor_v=None),
    ]


def small_run(folder: Path, supersede: bool = True) -> Path:
    """The run; with ``supersede`` its third sweep was played again as the fourth."""
    path = write_imported(sweeps(), folder / "small.h5", [])
    if supersede:
        with h5py.File(path, "r+") as f:
            f["entry/sweep_0003"].attrs["superseded_by"] = "sweep_0004"
    return path
