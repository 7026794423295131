"""Looks at the samples of one sweep: all there, possible, moving, and saying the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from piezo_rig.run_file.reader import LARGEST, decimate
from piezo_rig.run_file.verify.calibration import Recorded
from piezo_rig.run_file.verify.verdict import Verdict

Problems = list[tuple[bool, str]]

FLAT_SAMPLES = 8
MOST_TRAVEL = 2.5  # times what the rig's config allows for
OUTLINE = 2000
STILL_SAMPLES = 20
REPEATS_FAULT, REPEATS_NOTE = 0.1, 0.03  # of the travel


@dataclass(frozen=True, eq=False)
class Channels:
    """The rows of a sweep as recorded: command (n,), measured channels (n * oversampling,)."""

    command_v: np.ndarray
    sensor_v: np.ndarray
    monitor_v: np.ndarray | None
    time_s: np.ndarray | None

    def drive_got(self, a: dict[str, Any]) -> np.ndarray:
        """Volts that the stack got, where they were measured, else those that were asked for.

        An amplifier that cannot follow is not the sensor's fault.
        """
        if self.monitor_v is not None:
            return decimate(self.monitor_v, a["oversampling"])
        return float(a["gain"]) * self.command_v + float(a["offset_v"])

    def outline_um(self, a: dict[str, Any]) -> np.ndarray:
        """Displacement from the first sample at `OUTLINE` places of the sweep, or all there are."""
        at = np.linspace(0, self.sensor_v.size - 1, min(OUTLINE, self.sensor_v.size)).astype(int)
        volts = self.sensor_v[at] - self.sensor_v[0]
        return np.asarray(volts * float(a["sensitivity_um_per_v"]) * int(a["polarity"]))


def check_channels(a: dict[str, Any], c: Channels, recorded: Recorded, origin: str) -> Problems:
    """What is wrong with the samples; the first kind of fault that makes others meaningless ends.

    Returns (fault, text) pairs.
    """
    factor = a["oversampling"]
    problems: Problems = []
    for channel, row, due in (
        ("sensor_v", c.sensor_v, c.command_v.size * factor),
        ("drive_monitor_v", c.monitor_v, c.command_v.size * factor),
        ("time_s", c.time_s, c.command_v.size),
    ):
        if row is not None and row.size != due:
            problems.append((True, f"{channel} has {row.size} samples, expected {due}"))
    if c.command_v.size < 2:
        problems.append((True, f"command_v has {c.command_v.size} samples"))
    if problems:
        return problems
    for channel, row in (
        ("command_v", c.command_v), ("sensor_v", c.sensor_v), ("drive_monitor_v", c.monitor_v),
        ("time_s", c.time_s),
    ):
        if row is None:
            continue
        with np.errstate(invalid="ignore"):
            bad = np.flatnonzero(~(np.abs(row) <= LARGEST))
        if bad.size == row.size and channel in ("command_v", "sensor_v") and origin == "IMPORTED":
            problems.append((True, f"{channel} was not recorded"))
        elif bad.size:
            text = f"{channel}: {bad.size} values missing, first at sample {bad[0]}"
            problems.append((True, text))
    if problems:
        return problems
    return (
        _possible(a, c, recorded, origin) + _zero(a, c, origin) + _clock(a, c)
        + _saturated(a, c) + _stands_still(a, c, origin) + _moves(a, c, recorded, origin)
    )


def _possible(a: dict[str, Any], c: Channels, recorded: Recorded, origin: str) -> Problems:
    """Values that the converters can have put out."""
    if origin == "IMPORTED":
        return []
    problems: Problems = []
    low, high = recorded.command_limits_v
    for channel, row, floor, ceiling in (
        ("command_v", c.command_v, low, high),
        ("sensor_v", c.sensor_v, -recorded.sensor_range_v, recorded.sensor_range_v),
        ("drive_monitor_v", c.monitor_v, -recorded.monitor_range_v, recorded.monitor_range_v),
    ):
        if row is None:
            continue
        slack = 1e-3 * max(abs(floor), abs(ceiling))
        beyond = np.flatnonzero((row < floor - slack) | (row > ceiling + slack))
        if beyond.size:
            problems.append((
                True, f"{channel} is {row[beyond[0]]:.6g} V at sample {beyond[0]}; the instrument "
                f"cannot go beyond {floor:g} .. {ceiling:g} V ({beyond.size} samples)",
            ))
    return problems


def _zero(a: dict[str, Any], c: Channels, origin: str) -> Problems:
    first = float(c.sensor_v[0])
    if a["history"] == "carried" or origin == "IMPORTED":
        return []
    if abs(float(a["zero_v"]) - first) > 1e-6 * max(1.0, abs(first)):
        return [(True, f"zero_v is {a['zero_v']:.6g} V, the first sample {first:.6g} V")]
    return []


def _clock(a: dict[str, Any], c: Channels) -> Problems:
    if c.time_s is None:
        return []
    steps = np.diff(c.time_s)
    back = np.flatnonzero(~(steps > 0))
    if back.size:
        return [(True, f"time_s does not grow at sample {back[0] + 1}")]
    rate = 1.0 / float(np.median(steps))
    if abs(rate / float(a["sample_rate"]) - 1) > 0.05:
        return [(True, f"sample_rate is {a['sample_rate']:g}, time_s says {rate:.6g} per second")]
    return []


def _saturated(a: dict[str, Any], c: Channels) -> Problems:
    problems: Problems = []
    factor = a["oversampling"]
    drive = c.drive_got(a)
    if np.ptp(c.sensor_v) == 0 or np.ptp(drive) == 0:
        return []
    for word, values in (("largest", c.sensor_v), ("smallest", -c.sensor_v)):
        top = values.max()
        flat = _longest_run(values >= top)
        if flat >= FLAT_SAMPLES * factor and _moves_there(drive, values, top, factor):
            text = f"sensor_v stays at its {word} value for {flat} samples: saturated"
            problems.append((True, text))
    return problems


def _stands_still(a: dict[str, Any], c: Channels, origin: str) -> Problems:
    """A sensor of one value for a while, inside its range, while the drive moves: no beam."""
    drive = c.drive_got(a)
    if origin == "IMPORTED" or np.ptp(drive) == 0 or np.ptp(c.sensor_v) == 0:
        return []
    factor = a["oversampling"]
    extremes = (c.sensor_v.min(), c.sensor_v.max())  # looked at for saturation
    edges = np.flatnonzero(np.diff(c.sensor_v) != 0) + 1
    starts, stops = np.append(0, edges), np.append(edges, c.sensor_v.size)
    for k in np.flatnonzero(stops - starts >= STILL_SAMPLES * factor):
        begin, end = starts[k] // factor, stops[k] // factor
        if c.sensor_v[starts[k]] not in extremes and (
            np.ptp(drive[begin:end]) > 0.02 * np.ptp(drive)
        ):
            return [(True, f"sensor_v stands still for {end - begin} samples from sample {begin} "
                           "on while the drive moves: the beam was lost, or the row was filled in")]
    return []


def _moves(a: dict[str, Any], c: Channels, recorded: Recorded, origin: str) -> Problems:
    """The sensor follows the drive, the right way round, and no further than a stack can go."""
    drive = float(a["gain"]) * c.command_v + float(a["offset_v"])
    span = float(np.ptp(drive))
    if span < 1.0:
        return []
    problems: Problems = []
    top = a.get("condition_upper_v")
    if origin != "IMPORTED" and isinstance(top, int | float) and abs(drive.max() - top) > 0.05:
        problems.append((
            True, f"its condition goes up to {top:g} V of drive, command_v to {drive.max():.3f} V",
        ))
    sensor = decimate(c.sensor_v, a["oversampling"])
    if np.ptp(sensor) == 0:
        return [*problems, (True, "sensor_v is one value throughout while the drive moves")]
    got = c.drive_got(a)
    if np.ptp(got) < 1.0:
        return problems
    moved = int(a["polarity"]) * (sensor - sensor[0]) * float(a["sensitivity_um_per_v"])
    agreement = float(np.corrcoef(got, moved)[0, 1])
    if agreement < -0.5:
        problems.append((
            origin != "IMPORTED",
            f"the displacement falls where the drive rises: polarity {a['polarity']} is wrong",
        ))
    elif origin != "IMPORTED" and abs(agreement) < 0.5:
        problems.append((
            True, f"the displacement does not follow the drive (correlation {agreement:.2f}): "
            "the rows are not of one sweep, or the beam was lost",
        ))
    if origin != "IMPORTED" and (travel := float(np.ptp(moved)) / max(span, float(np.ptp(got)))) > (
        MOST_TRAVEL * recorded.travel_um_per_v
    ):
        problems.append((
            True, f"the stack would move {travel:.3g} um per volt, the rig's config allows for "
            f"{recorded.travel_um_per_v:g}: the sensitivity is wrong, or the sensor jumped",
        ))
    return problems


def check_repeats(outlines: dict[str, tuple[str, np.ndarray]]) -> list[Verdict]:
    """Three or more repeats of one condition move alike.

    ``outlines`` holds by name the condition and the displacement at some places, um. Spikes do
    not count: only what differs in more than a hundredth of the sweep.
    """
    found: list[Verdict] = []
    by_condition: dict[tuple[str, int], list[str]] = {}
    for name, (condition, outline) in outlines.items():
        by_condition.setdefault((condition, outline.size), []).append(name)
    for same in by_condition.values():
        if len(same) < 3:
            continue
        usual = np.median([outlines[n][1] for n in same], axis=0)
        travel = float(np.ptp(usual))
        for name in same:
            outline = outlines[name][1]
            off = float(np.quantile(np.abs(outline - usual), 0.99))
            if off > REPEATS_NOTE * travel:
                found.append(Verdict(
                    name, off > REPEATS_FAULT * travel,
                    f"differs from its repeats by {off:.3g} um of {travel:.4g} um of travel (it "
                    f"travels {np.ptp(outline):.4g} um): the sensitivity switch was moved, the "
                    "sensor lost count, or the row is of another sweep",
                ))
    return found


def _longest_run(mask: np.ndarray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return int((edges[1::2] - edges[::2]).max()) if edges.size else 0


def _moves_there(drive: np.ndarray, values: np.ndarray, top: float, factor: int) -> bool:
    """Whether the drive moves while the sensor stands still at its extreme."""
    at = np.flatnonzero(values[::factor] >= top)
    return at.size > 1 and float(np.ptp(drive[at])) > 0.02 * float(np.ptp(drive))
