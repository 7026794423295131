"""What a recording shows of its own faults: a sensor at its stop, a drive that is not as named."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from piezo_rig.run_file.sweep import FloatArray

_FEWEST_FLAT = 5
_MOVED = 0.03
_OFF_BY = 0.1


def saturation(drive_v: FloatArray, sensor: FloatArray, where: Callable[[int], str]) -> list[str]:
    """Warnings where the sensor stands still at an extreme while the drive moves on.

    Parameters
    ----------
    drive_v, sensor : shape (n,)
    where : words for the place of a sample
    """
    lowest, highest = float(sensor.min()), float(sensor.max())
    if lowest == highest:
        return ["the sensor never moves: every sample has the same value"]
    span = float(np.ptp(drive_v))
    warnings = []
    for level, side in ((lowest, "lowest"), (highest, "highest")):
        runs = [
            (start, stop)
            for start, stop in _runs(sensor == level)
            if np.ptp(drive_v[start:stop]) > _MOVED * span
        ]
        if runs:
            count = sum(stop - start for start, stop in runs)
            start, stop = runs[0]
            warnings.append(
                f"the sensor stands at its {side} value, {level:.6g}, while the drive moves: "
                f"{count} samples in {len(runs)} stretch{'es' if len(runs) > 1 else ''}, "
                f"first samples {start} to {stop - 1} (from {where(start)}); it may be saturated"
            )
    return warnings


def compare_span(drive_v: FloatArray, span_v: tuple[float, float] | None) -> list[str]:
    """A warning where the drive does not span what the file's name says."""
    if span_v is None or span_v[0] == span_v[1]:
        return []
    lower, upper = span_v
    lowest, highest = float(drive_v.min()), float(drive_v.max())
    allowed = _OFF_BY * (upper - lower)
    from_rest = min(lower, 0.0)  # a sweep of 75-65 rises from 0 V first
    if abs(highest - upper) <= allowed and from_rest - allowed <= lowest <= lower + allowed:
        return []
    return [
        f"its name says {lower:g} to {upper:g} V, but its drive runs from {lowest:.4g} to "
        f"{highest:.4g} V: gain, offset or channel may be wrong"
    ]


def _runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """Stretches of true values that are long enough to mean something, ``[start, stop)``."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False]))))
    starts, stops = edges[::2], edges[1::2]
    long = stops - starts >= _FEWEST_FLAT
    return [(int(a), int(b)) for a, b in zip(starts[long], stops[long], strict=True)]
