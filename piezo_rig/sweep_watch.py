"""What a sweep shows of its own faults, looked at while the run still plays.

Every fault is flagged in the run's log and on the terminal as soon as the sweep
that shows it is stored. A fault that will spoil whatever follows stops the run;
after one that is over, the run goes on, and ends with an error that names the
sweeps concerned.

The test behind most of it: over every volt or so that the drive is asked to
move, stack and sensor have to move by a fair share of what is due.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezo_rig.config import Rig
from piezo_rig.errors import BenchError

Array = NDArray[np.float64]

FULL_SCALE = 32767  # codes of the digitizer, of either sign
FEWEST = 5  # samples at a stop that are more than a spike
STRETCH_V = 1.0  # drive over which something has to move
FEWEST_STRETCHES = 3
FAIR_SHARE = 0.12  # a switch that stands one position too high leaves a quarter
LEAST_SPAN_V = 5.0  # of a half loop whose travel tells the sensitivity
LOW_RATIO, HIGH_RATIO = 0.3, 2.0  # travel over what the actuator is said to do; the switch: 4
JUMP_UM = 0.1  # from sample to sample beyond what the drive explains

_CAUSES = {
    "beam-interruption": (
        "something was in the beam, or the mirror is out of line; the count of fringes is lost",
        "clear the beam, reset the interferometer, and play these conditions again",
    ),
    "sensor-clipping": (
        "the travel is larger than the sensor's output or the digitizer's range, or the "
        "sensitivity switch stands elsewhere than the config says",
        "check the switch; choose a larger range or another sensitivity",
    ),
    "drive-clipping": (
        "the amplifier does not reach the voltage that is asked for, or the monitor is not wired",
        "check the amplifier's limit switch, its set voltage and the monitor's cable",
    ),
    "sensor-sensitivity": (
        "the sensitivity switch was turned, or the sensor is not connected; or the actuator's "
        "travel_um_per_v in the rig's config is wrong",
        "set the switch to what the config says and check the beam",
    ),
}


@dataclass(frozen=True)
class Flag:
    """One fault that a sweep shows.

    Attributes
    ----------
    code : stable identifier, a key of the table of causes
    what : in words
    first, count : samples concerned
    stops : whether everything after it would be spoilt too
    usable : whether the sweep can still be diagnosed (a noisy plateau is a cause to be found)
    """

    code: str
    what: str
    first: int
    count: int
    stops: bool = False
    usable: bool = False


def watch(
    rig: Rig, drive_v: Array, recorded: Any, log: Callable[..., None], sweep: str,
    tell: Callable[[str], None],
) -> None:
    """Flag what a stored sweep shows; to be called before the next one is played.

    Parameters
    ----------
    drive_v : shape (n,), as planned
    recorded : with ``sensor_v`` and ``monitor_v`` (or None), oversampled or not
    log : takes an event and its fields
    sweep : name of the sweep, for the words
    tell : takes a line for the terminal

    Raises
    ------
    BenchError : with the flag's code, when the run cannot go on
    """
    flags = list(look(rig, drive_v, recorded.sensor_v, recorded.monitor_v))
    for flag in flags:
        tell(f"flag[{flag.code}]: {sweep}: {flag.what}")
        log(
            "flag", code=flag.code, sweep=sweep, what=flag.what, first=flag.first,
            count=flag.count, usable=flag.usable,
        )
    for flag in flags:
        if flag.stops:
            cause, remedy = _CAUSES[flag.code]
            raise BenchError(flag.code, f"{sweep}: {flag.what}", cause, remedy)


def error_of(events: Iterable[dict[str, Any]], names: Collection[str]) -> BenchError | None:
    """The error that a run ends with whose events hold flags of unusable sweeps.

    ``names`` are the sweeps that count; those that were played again do not.
    """
    flags = [
        e for e in events
        if e.get("event") == "flag" and not e.get("usable") and e.get("sweep") in names
    ]
    if not flags:
        return None
    code = str(flags[0]["code"])
    sweeps = sorted({str(flag["sweep"]) for flag in flags})
    shown = ", ".join(sweeps[:5]) + (f" and {len(sweeps) - 5} more" if len(sweeps) > 5 else "")
    cause, remedy = _CAUSES.get(code, ("", ""))
    return BenchError(
        code, f"the run is whole, but not all of it is good: {shown}: {flags[0]['what']}",
        cause, f"{remedy}; the other sweeps are good",
    )


def look(rig: Rig, drive_v: Array, sensor_v: Array, monitor_v: Array | None) -> Iterator[Flag]:
    """The faults that one sweep shows. All in volts, shapes (n,) and (n x oversampling,)."""
    factor = rig.digitizer.oversampling
    full_scale = rig.digitizer.sensor_range_v
    expected = rig.actuator.travel_um_per_v / rig.sensitivity_um_per_v  # V of sensor per V
    sensor = np.asarray(sensor_v, dtype=float)[::factor][: drive_v.size]
    steps = _Stretches(drive_v, max(STRETCH_V, 20 * full_scale / FULL_SCALE / expected))
    jump_v = JUMP_UM / rig.sensitivity_um_per_v + 10 * expected * steps.fastest
    driven, reached, spoilt = np.ones(steps.begin.size, dtype=bool), drive_v, False
    if monitor_v is not None:
        reached = np.asarray(monitor_v, dtype=float)[::factor][: drive_v.size]
        driven = steps.span(reached) >= FAIR_SHARE * steps.way_v
        for flag in _clipped_drive(reached, steps.runs(~driven)):
            spoilt = True
            yield flag
    for flag in _still(sensor, steps, driven, expected, full_scale, jump_v):
        spoilt = True
        yield flag
    if not spoilt:
        yield from _sensitivity(drive_v, reached, sensor, expected)


class _Stretches:
    """A sweep cut where the drive has gone a certain way further."""

    def __init__(self, drive_v: Array, way_v: float) -> None:
        moved = np.abs(np.diff(drive_v, prepend=drive_v[:1]))
        self.fastest = float(moved.max())
        gone = np.cumsum(moved)
        marks = np.arange(0.0, gone[-1], way_v)
        edges = np.searchsorted(gone, marks, side="right") - 1
        self.begin = np.unique(np.maximum(edges, 0))
        self.way_v = way_v
        self.end = np.append(self.begin[1:], drive_v.size)

    def span(self, values: Array) -> Array:
        """Largest less smallest value in each stretch, the next one's first sample included."""
        if not self.begin.size:
            return np.empty(0)
        top = np.maximum.reduceat(values, self.begin)
        bottom = np.minimum.reduceat(values, self.begin)
        after = values[np.minimum(self.end, values.size - 1)]
        return np.asarray(np.maximum(top, after) - np.minimum(bottom, after))

    def runs(self, still: NDArray[np.bool_]) -> list[tuple[int, int]]:
        """Samples [first, last) of every run of at least `FEWEST_STRETCHES` stretches."""
        return [
            (int(self.begin[a]), int(self.end[b - 1]))
            for a, b in _runs(still[: self.begin.size - 1]) if b - a >= FEWEST_STRETCHES
        ]  # the last stretch is cut short by the end of the sweep


def _runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False]))))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _still(
    sensor: Array, steps: _Stretches, driven: NDArray[np.bool_], expected: float,
    full_scale: float, jump_v: float,
) -> Iterator[Flag]:
    """Where the sensor stands at a stop, or stands still while the drive moves on."""
    stop_v = full_scale * (1 - 0.5 / FULL_SCALE)
    at_stop = [(a, b) for a, b in _runs(np.abs(sensor) >= stop_v) if b - a >= FEWEST]
    inside = np.zeros(sensor.size, dtype=bool)
    for a, b in at_stop:
        inside[a:b] = True
    still = steps.runs(driven & (steps.span(sensor) < FAIR_SHARE * expected * steps.way_v))
    places = at_stop + [(a, b) for a, b in still if not inside[a:b].any()]
    for a, b in places:
        inside[a:b] = True
    places += [
        (a, b) for a, b in _equal(sensor)
        if not inside[a:b].any() and any(_jumps_at(sensor, a, b, jump_v))
    ]
    found: dict[tuple[str, bool], list[tuple[int, int]]] = {}
    last_edge = int(steps.begin[-1]) if steps.begin.size else sensor.size
    for a, b in sorted(places):
        first, last = _jumps_at(sensor, a, b, jump_v)
        lost = bool(first or last) or a == 0  # at rest nothing is at its stop
        still_lost = lost and not last and b >= last_edge
        a, b = first or a, last or (sensor.size if still_lost else b)
        exact = bool(np.ptp(sensor[a:b]) == 0.0)
        code = "beam-interruption" if lost else "sensor-clipping"
        found.setdefault((code, exact), []).append((a, b))
    for (code, exact), where in found.items():
        a, b = where[0]
        count = sum(stop - start for start, stop in where)
        still_lost = code == "beam-interruption" and where[-1][1] == sensor.size
        told = {"beam-interruption": "the beam is lost"}.get(code, "the sensor's output is cut off")
        yield Flag(
            code,
            f"{told} at {sensor[a]:.4g} V for {count} samples in {len(where)} place"
            f"{'s' if len(where) > 1 else ''}, the first is number {a}"
            + ("; it was not back at the end" if still_lost else ""),
            a, count,
            stops=still_lost or (code == "sensor-clipping" and exact),
            usable=code == "sensor-clipping" and not exact,
        )


def _equal(sensor: Array) -> list[tuple[int, int]]:
    """Runs of one and the same value that are too long for a sensor with its noise."""
    return [(a, b + 1) for a, b in _runs(np.diff(sensor) == 0.0) if b - a >= 2 * FEWEST]


def _jumps_at(sensor: Array, a: int, b: int, jump_v: float) -> tuple[int, int]:
    """Where a stretch is entered, and left, by a jump from or to another level; 0: it is not."""
    near = max(FEWEST, (b - a) // 2)
    low, high = max(0, a - near), min(sensor.size, b + near)
    level = float(np.median(sensor[a:b]))
    jumps = low + 1 + np.flatnonzero(np.abs(np.diff(sensor[low:high])) > jump_v)
    entered = jumps[(jumps <= (a + b) // 2) & (np.abs(sensor[jumps - 1] - level) > jump_v)]
    left = jumps[(jumps > (a + b) // 2) & (np.abs(sensor[jumps] - level) > jump_v)]
    return int(entered[-1]) if entered.size else 0, int(left[0]) if left.size else 0


def _sensitivity(
    drive_v: Array, reached: Array, sensor: Array, expected: float
) -> Iterator[Flag]:
    """Half loops whose travel is far from what the actuator can do over the drive it got."""
    way = np.sign(np.diff(drive_v))
    moving = np.flatnonzero(way)
    if not moving.size:
        return
    turns = moving[np.flatnonzero(np.diff(way[moving])) + 1]
    corners = np.unique(np.concatenate([[0], turns, [drive_v.size - 1]]))
    span_v = np.abs(np.diff(reached[corners]))
    # A spike at a corner is not the travel.
    levels = [np.median(sensor[max(0, c - 2) : c + 3]) for c in corners]
    travel_v = np.abs(np.diff(levels))
    # A drive that came nowhere near turns elsewhere than planned: nothing can be said.
    near = span_v >= 0.5 * np.abs(np.diff(drive_v[corners]))
    for i in np.flatnonzero(near & (span_v >= LEAST_SPAN_V)):
        ratio = travel_v[i] / (expected * span_v[i])
        if not LOW_RATIO <= ratio <= HIGH_RATIO:
            yield Flag(
                "sensor-sensitivity",
                f"over {span_v[i]:.0f} V the sensor shows {ratio:.2g} times the travel that the "
                f"actuator has, from sample {corners[i]}",
                int(corners[i]), int(corners[i + 1] - corners[i]), stops=True,
            )
            return


def _clipped_drive(monitor: Array, where: list[tuple[int, int]]) -> Iterator[Flag]:
    if where:
        a, _ = where[0]
        yield Flag(
            "drive-clipping",
            f"the drive monitor stands at {monitor[a]:.2f} V in {len(where)} place"
            f"{'s' if len(where) > 1 else ''} while the drive is asked to move on, the first "
            f"time from sample {a}",
            a, sum(stop - start for start, stop in where),
        )
