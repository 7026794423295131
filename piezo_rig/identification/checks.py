"""What a recording must hold before anything is fitted to it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import dead_band
from piezo_rig.chain.half_loops import REACH, noise
from piezo_rig.errors import InputError
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]
AGREE = 0.01  # calibrations may differ by this share
SPIKE = 0.5  # of the travel: one sample that far from both its neighbours is no movement
MOST_SPIKES = 0.01  # of the samples; more of them are not interruptions
FALLS = -0.5  # correlation of drive and displacement below which the polarity must be wrong
FLAT_SHARE = 0.04  # of the drive's range may pass while the sensor stands at its extreme


def label(sweep: Sweep) -> str:
    """A sweep's name as an error should say it."""
    return f"{sweep.source}: {sweep.name}" if sweep.source else sweep.name


def check_sweep(sweep: Sweep) -> None:
    """Raise InputError for what cannot be identified; names sweep and sample."""
    where = label(sweep)
    drive, displacement = sweep.drive_v, sweep.displacement_um
    if drive.shape != displacement.shape or drive.ndim != 1:
        raise InputError(
            "unequal-lengths",
            f"{where}: {drive.size} samples of drive, {displacement.size} of displacement",
            "one column is cut short",
            "repair the recording, or cut both to the shorter length",
        )
    if drive.size < 8:
        raise InputError(
            "too-few-samples",
            f"{where}: {drive.size} samples",
            "an empty or broken recording",
            "leave this recording out",
        )
    for name, values in (("drive", drive), ("displacement", displacement)):
        if not np.isfinite(values.sum()):
            bad = np.flatnonzero(~np.isfinite(values))
            if bad.size:
                raise InputError(
                    "not-a-number",
                    f"{where}: the {name} is not a number at sample {bad[0]} ({bad.size} in all)",
                    "a gap in the recording",
                    "cut the gap out, or interpolate it",
                )
    _check_drive(where, drive)
    _check_sensor(where, drive, displacement)
    _check_polarity(where, sweep, drive, displacement)


def _check_drive(where: str, drive: FloatArray) -> None:
    low, high = float(drive.min()), float(drive.max())
    band = dead_band(drive)
    if high - low <= max(REACH * noise(drive), 1e-9 * max(abs(low), abs(high))):
        raise InputError(
            "constant-drive",
            f"{where}: the drive stays at {drive[0]:.4g} V",
            "the wrong channel, or a generator that was off",
            "check which channel is the command",
        )
    # the way back: how far the drive ever came down from a past maximum, or up from a minimum
    down = float(np.max(np.maximum.accumulate(drive) - drive))
    up = float(np.max(drive - np.minimum.accumulate(drive)))
    if min(down, up) <= max(band, 1e-3 * (high - low)):
        raise InputError(
            "drive-never-returns",
            f"{where}: the drive goes from {drive[0]:.4g} V to {drive[-1]:.4g} V and never turns",
            "only part of a cycle was recorded",
            "record at least one full cycle",
        )


def _check_sensor(where: str, drive: FloatArray, displacement: FloatArray) -> None:
    travel = float(np.ptp(displacement))
    if travel == 0.0:
        raise InputError(
            "constant-displacement",
            f"{where}: the displacement does not change while the drive does",
            "the wrong channel, a beam that is interrupted, or a sensor that is off",
            "check which channel is the sensor",
        )
    band = dead_band(displacement)
    # a sensor that is still alive would move by more than its noise over so much drive
    span = float(np.ptp(drive)) * max(FLAT_SHARE, 4.0 * band / travel)
    for extreme, side in ((displacement.max(), "largest"), (displacement.min(), "smallest")):
        flat = np.abs(displacement - extreme) <= band
        if np.count_nonzero(flat) < 6:
            continue
        edges = np.flatnonzero(np.diff(np.concatenate([[0], flat.astype(np.int8), [0]])))
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            if b - a >= 6 and np.ptp(drive[a:b]) > span:
                raise InputError(
                    "sensor-saturated",
                    f"{where}: the sensor stands at its {side} value "
                    f"({extreme:.5g} um) from sample {a} to {b - 1} while the drive moves "
                    f"{np.ptp(drive[a:b]):.3g} V",
                    "the sensor's output or the digitizer's input range is exceeded",
                    "set a larger sensitivity switch or input range and record again",
                )


def without_spikes(sweep: Sweep) -> tuple[Sweep, str]:
    """The sweep with beam interruptions bridged, and what was done ('' if nothing).

    Only single samples that leave their neighbours by half the travel or more; smaller ones
    do a fit no harm.
    """
    y = sweep.displacement_um
    away = np.abs(y[1:-1] - 0.5 * (y[:-2] + y[2:]))
    limit = SPIKE * float(np.ptp(np.percentile(y, [1.0, 99.0])))
    found = np.flatnonzero((away > limit) & (np.abs(y[2:] - y[:-2]) < 0.5 * limit)) + 1
    if found.size == 0 or found.size > MOST_SPIKES * y.size or limit == 0.0:
        return sweep, ""
    volts = sweep.sensor_v.copy()
    volts[found] = 0.5 * (volts[found - 1] + volts[found + 1])
    which = ", ".join(str(i) for i in found[:5]) + (" ..." if found.size > 5 else "")
    return sweep.with_(sensor_v=volts), (
        f"warning: {label(sweep)}: the displacement jumps by more than half its travel and back "
        f"at sample {which}: bridged"
    )


def _check_polarity(
    where: str, sweep: Sweep, drive: FloatArray, displacement: FloatArray
) -> None:
    agreement = float(np.corrcoef(drive, displacement)[0, 1])
    if agreement < FALLS:
        raise InputError(
            "displacement-falls",
            f"{where}: the displacement falls while the drive rises "
            f"(correlation {agreement:.2f}), with polarity {sweep.polarity:+d}",
            "the sensor looks at the other side, or the polarity given is the wrong one",
            f"give --polarity={-sweep.polarity:+d} for sensor volts, "
            "or change the sign of the displacement column",
        )


def check_agreement(sweeps: Sequence[Sweep]) -> None:
    """Raise InputError when sweeps come from differently calibrated benches."""
    first = sweeps[0]
    scale = abs(first.gain) * 10.0
    for sweep in sweeps[1:]:
        pairs = (
            ("gain", first.gain, sweep.gain, abs(first.gain)),
            ("offset", first.offset_v, sweep.offset_v, max(abs(first.offset_v), scale)),
            (
                "sensitivity",
                first.sensitivity_um_per_v,
                sweep.sensitivity_um_per_v,
                abs(first.sensitivity_um_per_v),
            ),
            ("polarity", float(first.polarity), float(sweep.polarity), 1.0),
        )
        for name, a, b, size in pairs:
            if abs(a - b) > AGREE * size:
                raise InputError(
                    "calibrations-disagree",
                    f"{name} is {a:g} in {label(first)} and {b:g} in {label(sweep)}",
                    "recordings of different benches, or one of them was imported "
                    "with other settings",
                    "import them again with the same calibration, or identify them apart",
                )
