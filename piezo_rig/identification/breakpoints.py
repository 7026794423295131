"""Where the break points are put: on grids, at equal displacements, or read off clean data."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from piezo_rig.identification.data import Data

FloatArray = NDArray[np.float64]


def equal_volts(reach_v: float, n: int) -> FloatArray:
    """n - 1 break points that cut 0..reach into n equal pieces."""
    return reach_v * np.arange(1.0, n) / n


def equal_travel(
    knots: FloatArray, compliance: FloatArray, reach_v: float, dx: float
) -> FloatArray:
    """Drives at which a curve has travelled dx, 2 dx, ... below its reach.

    This is the thesis's spacing: elements give way at equal steps of displacement.
    """
    drive = np.concatenate([[0.0], knots[knots < reach_v], [reach_v]])
    c = compliance[: drive.size - 1]
    travel = np.concatenate([[0.0], np.cumsum(c * np.diff(drive))])
    steps = dx * np.arange(1.0, int(np.ceil(travel[-1] / dx - 1e-9)))
    return np.interp(steps, travel, drive)


def read_off(data: Data, sigma_um: float) -> tuple[FloatArray, FloatArray]:
    """Break points of clean, piecewise linear data: of the first rise, and of a later branch.

    Lines are grown sample by sample along the longest half loop of each kind; where one no
    longer fits, the next begins, and break points are where neighbours cross.

    Returns
    -------
    first_knots, later_knots : volts since the beginning of the half loop; empty where unknown
    """
    best = [(0.0, 0, 0, 0), (0.0, 0, 0, 0)]
    for t, track in enumerate(data.tracks):
        for start, stop in zip(track.loops.start, track.loops.stop, strict=True):
            kind = 0 if start == 0 else 1
            if kind == 0 and not track.virgin:
                continue
            if not any(a <= start and stop < b for a, b in track.blocks):
                continue
            span = abs(track.drive_v[stop] - track.drive_v[start])
            if span > best[kind][0] * (1 + 1e-9):
                best[kind] = (float(span), t, int(start), int(stop))
    out = []
    for span, t, start, stop in best:
        if span == 0.0:
            out.append(np.empty(0))
            continue
        v = data.tracks[t].drive_v[start : stop + 1]
        y = data.tracks[t].displacement_um[start : stop + 1]
        distance, change = np.abs(v - v[0]), np.abs(y - y[0])
        keep = np.concatenate([[True], np.diff(distance) > 1e-12 * span])
        out.append(_crossings(distance[keep], change[keep], max(sigma_um, 1e-13 * np.ptp(y))))
    return out[0], out[1]


def _crossings(d: FloatArray, y: FloatArray, sigma: float) -> FloatArray:
    lines: list[tuple[float, float]] = []
    i = 0
    tolerance = 8.0 * sigma
    while i + 2 < d.size:
        # a line through three samples, refitted as it grows
        j = i + 3
        slope, level = np.polyfit(d[i:j] - d[i], y[i:j], 1)
        if np.max(np.abs(level + slope * (d[i:j] - d[i]) - y[i:j])) > tolerance:
            i += 1
            continue
        while j < d.size and abs(level + slope * (d[j] - d[i]) - y[j]) <= tolerance:
            j += 1
            if j - i in (6, 12, 24, 48, 96):
                slope, level = np.polyfit(d[i:j] - d[i], y[i:j], 1)
        # the last sample may lie just past the break
        stop = max(j - 1, i + 3)
        slope, level = np.polyfit(d[i:stop] - d[i], y[i:stop], 1)
        lines.append((float(slope), float(level - slope * d[i])))
        i = j
        if len(lines) > 400:
            return np.empty(0)
    tail: list[float] = []
    if lines and i < d.size:  # a last piece too short for a line of its own
        slope, level = lines[-1]
        beyond = np.flatnonzero(np.abs(level + slope * d - y) > tolerance)
        beyond = beyond[beyond >= i - 1]
        if beyond.size >= 2:
            a, b = beyond[-2], beyond[-1]
            steep = (y[b] - y[a]) / (d[b] - d[a])
            lines.append((float(steep), float(y[b] - steep * d[b])))
        elif beyond.size:
            tail = [float((d[-1] + d[-2]) / 2.0)]
    knots = tail
    for (s, c), (s2, c2) in pairwise(lines):
        if abs(s2 - s) > 1e-9 * abs(s):
            knots.append((c - c2) / (s2 - s))
    found = np.array(knots)
    gap = 1e-6 * d[-1]
    good = (found > gap) & (found < d[-1] - gap)
    found = np.sort(found[good])
    return found[np.concatenate([[True], np.diff(found) > gap])] if found.size else found
