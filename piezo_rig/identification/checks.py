"""What a recording must hold before anything is fitted to it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import dead_band
from piezo_rig.chain.half_loops import REACH, noise
from piezo_rig.errors import InputError
from piezo_rig.run_file.sweep import Sweep

FloatArray = NDArray[np.float64]
AGREE = 0.01  # calibrations may differ by this share
SPIKE = 0.5  # of the travel: one sample that far from both its neighbours is no movement
LOOKED_AT = 4000  # samples for a range
MOST_SPIKES = 0.01  # of the samples; more of them are not interruptions
DRIVE_SPIKE = 0.05  # of the drive's range: the memory takes every volt, so less is a spike there
JUMP = 0.05  # of the travel, from one sample to the next, that the drive does not explain
CLEAR = 5.0  # times what all but one in a hundred samples do
ANSWERS = 0.25  # of what such a drive would move: it was played, and is no spike
FALLS = -0.5  # correlation of drive and displacement below which the polarity must be wrong
BACK = 0.25  # of a stretch without motion before a turning point that there is after it
FLAT_SHARE = 0.04  # of the drive's range may pass while the sensor stands at its extreme
PIECES = 100  # of a recording, that are compared
STANDS = 0.01  # of the travel, by which what stands still may move
WENT = 0.3  # of the drive's range, that passes while it does
WITHIN = 0.1  # of the travel from the ends: what stands there has come to an end of the sensor
APART = 2.5  # times as far per volt as others: no actuator does that, units and wires do
SWINGS = 0.1  # of the largest drive range, below which a recording says little of that
SHARE = 0.05  # of its own drive range, below which a piece of it does
STEP_OF_SWITCH = 3.0, 5.0  # times, that are likely one position of a sensitivity switch
OF_UNITS = 500.0, 2000.0  # times, that are likely nm for um


def label(sweep: Sweep) -> str:
    """A sweep's name as an error should say it."""
    return f"{sweep.source}: {sweep.name}" if sweep.source else sweep.name


def check_numbers(sweep: Sweep) -> None:
    """Raise InputError for what are no numbers, or too few; names sweep and sample."""
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


def check_signals(sweep: Sweep, clipped: bool = False) -> list[str]:
    """Raise InputError for a drive or a sensor that tells nothing; names sweep and sample.

    ``clipped`` : flat tops are only said, for whoever finds out what cut them off
    """
    where, drive, displacement = label(sweep), sweep.drive_v, sweep.displacement_um
    _check_drive(where, drive)
    said = []
    try:
        _check_sensor(where, drive, displacement)
    except InputError as error:
        if not clipped or error.code != "sensor-saturated":
            raise
        said.append(f"warning: {error.what}")
    _check_standing(where, drive, displacement)
    _check_polarity(where, sweep, drive, displacement)
    return said


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
            "only part of a cycle was recorded, or the file was cut off",
            "leave this recording out, or record at least one full cycle; pieces of one drive "
            "belong in one recording",
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
    sigma = noise(drive)
    span = float(np.ptp(drive)) * max(FLAT_SHARE, 4.0 * band / travel)
    for extreme, side in ((displacement.max(), "largest"), (displacement.min(), "smallest")):
        flat = np.abs(displacement - extreme) <= band
        if np.count_nonzero(flat) < 6:
            continue
        edges = np.flatnonzero(np.diff(np.concatenate([[0], flat.astype(np.int8), [0]])))
        only = edges.size == 2
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            moved = _moved(drive[a:b], sigma) if b - a >= 6 else 0.0
            # nobody knows how a stretch would go on at which a recording ends
            cut = (only and b == drive.size) or _stays(drive[a:b], sigma)
            if moved > span and cut:
                raise InputError(
                    "sensor-saturated",
                    f"{where}: the sensor stands at its {side} value "
                    f"({extreme:.5g} um) from sample {a} to {b - 1} while the drive moves "
                    f"{moved:.3g} V",
                    "the sensor's output or the digitizer's input range is exceeded",
                    "set a larger sensitivity switch or input range and record again",
                )


def _check_standing(where: str, drive: FloatArray, displacement: FloatArray) -> None:
    """Refuse a sensor that has stopped: it stands still within its range while the drive moves.

    At an end of its output it would follow again as soon as the drive comes back.
    """
    long = drive.size // PIECES
    if long < 2:
        return
    v, x = (y[: long * PIECES].reshape(PIECES, long).mean(axis=1) for y in (drive, displacement))
    low, high = np.percentile(displacement, [1.0, 99.0])
    travel, swing = float(high - low), float(np.ptp(drive))
    begin = 0
    for k in range(1, PIECES + 1):
        if k < PIECES and abs(x[k] - x[begin]) <= STANDS * travel:
            continue
        passed, stands = v[begin:k] - v[begin], float(x[begin])
        down = -float(passed.min()) > WENT * swing and stands > low + WITHIN * travel
        up = float(passed.max()) > WENT * swing and stands < high - WITHIN * travel
        if down or up:
            raise InputError(
                "sensor-stands-still",
                f"{where}: the displacement stands still at {stands:.5g} um from sample "
                f"{begin * long} to {k * long - 1} while the drive moves {np.ptp(passed):.3g} V",
                "the beam was interrupted, the reflector came off, or the sensor's cable did",
                "leave this recording out, or cut it off before that",
            )
        begin = k


def _stays(drive: FloatArray, sigma: float) -> bool:
    """Whether a value that stood still on the way to a turning point also does on the way back.

    What a sensor cuts off begins and ends at one displacement. Where everything slides (a
    friction damper) the displacement follows again at once when the drive turns.
    """
    turn = int(np.argmax(np.abs(drive - drive[0])))
    before, after = _moved(drive[: turn + 1], sigma), _moved(drive[turn:], sigma)
    return after > BACK * before


def _moved(drive: FloatArray, sigma: float) -> float:
    """Volts that a stretch of drive runs through beyond what noise alone would show."""
    by_noise = sigma * (2.0 * float(np.sqrt(2.0 * np.log(drive.size))) + 2.0)
    return max(float(np.ptp(drive)) - by_noise, 0.0)


def without_spikes(sweep: Sweep) -> tuple[Sweep, list[str]]:
    """The sweep with interruptions bridged, and what was done or is to be feared.

    Bridged are single samples: of the displacement where they leave their neighbours by half the
    travel or more (smaller ones do a fit no harm), of the drive where they leave them by much
    less, because the memory takes the largest drive for good. What lasts longer is only said.
    """
    drive, y = sweep.drive_v, sweep.displacement_um
    said: list[str] = []
    where = f"warning: {label(sweep)}"
    found = _isolated(y, SPIKE * _spread(y))
    played = _isolated(drive, DRIVE_SPIKE * _spread(drive), CLEAR)
    if played.size:
        # a drive that was really played moves the actuator too
        slope = _spread(y) / max(_spread(drive), 1e-30)
        answered = _away(y)[played - 1] > ANSWERS * slope * _away(drive)[played - 1]
        both = played[answered]
        found, played = np.setdiff1d(found, both), played[~answered]
    if played.size:
        sweep = sweep.with_(command_v=_bridged(sweep.command_v, played))
        said.append(
            f"{where}: the drive jumps to {drive[played[0]]:.5g} V and back at sample "
            f"{_listed(played)}, and the displacement does not follow: bridged"
        )
    if found.size:
        sweep = sweep.with_(sensor_v=_bridged(sweep.sensor_v, found))
        said.append(
            f"{where}: the displacement jumps by more than half its travel and back "
            f"at sample {_listed(found)}: bridged"
        )
    return sweep, said + _jumps(where, sweep)


@lru_cache(maxsize=64)
def _somewhere(n: int) -> NDArray[np.int64]:
    """Samples that stand for all n of them, the same ones every time."""
    return np.sort(np.random.default_rng(0).integers(0, n, LOOKED_AT))


def _spread(values: FloatArray) -> float:
    """Range of all but the outermost samples."""
    if values.size > LOOKED_AT:
        values = values[_somewhere(values.size)]
    return float(np.ptp(np.percentile(values, [1.0, 99.0])))


def _away(values: FloatArray) -> FloatArray:
    """Distance of every inner sample from the middle of its neighbours, shape (n - 2,)."""
    return np.abs(values[1:-1] - 0.5 * (values[:-2] + values[2:]))


def _isolated(values: FloatArray, limit: float, clear: float = 0.0) -> NDArray[np.intp]:
    """Samples that leave both their neighbours by a limit; none where they are too many.

    With ``clear`` they leave them by that many times what all but one in a hundred samples do.
    """
    away = _away(values)
    found = np.flatnonzero(away > limit)
    if found.size and clear:
        limit = max(limit, clear * float(np.percentile(away, 99.0)))
        found = found[away[found] > limit]
    found = found[np.abs(values[found + 2] - values[found]) < 0.5 * limit] + 1
    return found if limit > 0.0 and found.size <= MOST_SPIKES * values.size else found[:0]


def _bridged(volts: FloatArray, found: NDArray[np.intp]) -> FloatArray:
    out = volts.copy()
    out[found] = 0.5 * (out[found - 1] + out[found + 1])
    return out


def _listed(found: NDArray[np.intp]) -> str:
    return ", ".join(str(i) for i in found[:5]) + (" ..." if found.size > 5 else "")


def _jumps(where: str, sweep: Sweep) -> list[str]:
    """A warning where the displacement leaps from one sample to the next without the drive."""
    drive, y = sweep.drive_v, sweep.displacement_um
    limit, steps = JUMP * _spread(y), np.abs(np.diff(y))
    if float(steps.max()) <= limit:
        return []
    slope = _spread(y) / max(_spread(drive), 1e-30)
    unexplained = np.maximum(steps - 2.0 * slope * np.abs(np.diff(drive)), 0.0)
    usual = CLEAR * float(np.percentile(unexplained, 99.0))
    found = np.flatnonzero(unexplained > max(limit, usual, 2.0 * REACH * noise(y))) + 1
    if not found.size or limit == 0.0 or found.size > MOST_SPIKES * y.size:
        return []
    largest = float(np.max(steps[found - 1]))
    return [
        f"{where}: the displacement jumps by up to {largest:.3g} um at sample {_listed(found)} "
        "while the drive does not: fringes lost, or a beam that was interrupted; a model is "
        "identified from the samples as they are, a diagnosis takes out what it names"
    ]


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
            f"give --polarity={-sweep.polarity:+d}",
        )


def check_agreement(sweeps: Sequence[Sweep]) -> None:
    """Raise InputError when sweeps come from differently calibrated benches.

    A drive or displacement that was recorded as such has no calibration, and agrees with any.
    """
    drives = [s for s in sweeps if not s.details.get("as_given_drive")]
    sensors = [s for s in sweeps if not s.details.get("as_given_displacement")]
    for sweep in drives[1:]:
        first = drives[0]
        _agree("gain", first.gain, sweep.gain, abs(first.gain), first, sweep)
        scale = max(abs(first.offset_v), 10.0 * abs(first.gain))
        _agree("offset", first.offset_v, sweep.offset_v, scale, first, sweep)
    for sweep in sensors[1:]:
        first = sensors[0]
        a, b = first.sensitivity_um_per_v, sweep.sensitivity_um_per_v
        _agree("sensitivity", a, b, abs(a), first, sweep)
        _agree("polarity", float(first.polarity), float(sweep.polarity), 1.0, first, sweep)
    _check_travels(sweeps)


def _check_travels(sweeps: Sequence[Sweep]) -> None:
    """Refuse recordings that move several times as far per volt as others."""
    largest = max(float(np.ptp(s.drive_v)) for s in sweeps)
    wide = [s for s in sweeps if float(np.ptp(s.drive_v)) > SWINGS * largest]
    moves = [_um_per_v(s) for s in wide]
    known = sorted((m, k) for k, m in enumerate(moves) if m > 0.0)
    if len(known) < 2 or known[-1][0] < APART * known[0][0]:
        return
    (least, slow), (most, fast) = known[0], known[-1]
    usual = known[len(known) // 2][0]
    alike = sum(usual / APART**0.5 < m < usual * APART**0.5 for m, _ in known)
    ratio, cause = most / least, "channels that are swapped in some of them, or another sensor"
    if OF_UNITS[0] < ratio < OF_UNITS[1]:
        cause = "one has nanometres where its column says micrometres"
    elif STEP_OF_SWITCH[0] < ratio < STEP_OF_SWITCH[1]:
        cause = "the sensitivity switch stood one position higher or lower in one of them"
    raise InputError(
        "travels-disagree",
        f"{label(wide[fast])} moves {most:.3g} um per volt of drive, and {label(wide[slow])} "
        f"{least:.3g}: {float(f'{ratio:.3g}'):,g} times less",
        f"{cause}; {alike} of {len(known)} recordings move about {usual:.3g}",
        "look at the columns and units of the files that differ, or leave them out",
    )


def _um_per_v(sweep: Sweep) -> float:
    """How far a recording moves per volt, in most of its pieces."""
    drive, displacement = sweep.drive_v, sweep.displacement_um
    long = max(drive.size // PIECES, 4)
    count = drive.size // long
    v, x = (y[: long * count].reshape(count, long) for y in (drive, displacement))
    v, x = v - v.mean(axis=1, keepdims=True), x - x.mean(axis=1, keepdims=True)
    power, moved = np.sum(v**2, axis=1), np.ptp(v, axis=1)
    moving = moved > min(SHARE * float(np.ptp(drive)), 0.5 * float(moved.max()))
    if not moving.any():
        return 0.0
    return float(abs(np.median(np.sum(v * x, axis=1)[moving] / power[moving])))


def _agree(name: str, a: float, b: float, size: float, first: Sweep, sweep: Sweep) -> None:
    if abs(a - b) > AGREE * size:
        raise InputError(
            "calibrations-disagree",
            f"{name} is {a:g} in {label(first)} and {b:g} in {label(sweep)}",
            "recordings of different benches, or one of them was imported with other settings",
            "import them again with the same calibration, or identify them apart",
        )
