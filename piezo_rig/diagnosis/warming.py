"""A rig that warms up, of which noise is measured between recordings.

What repeats disagree by is taken for noise. A zero that drifts steadily is the same in all of them;
one that settles over the session is not, and a noise that holds it hides that drift, and whatever
else is slow.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from piezo_rig.causes.cause import added_by
from piezo_rig.causes.thermal_drift import ThermalDrift
from piezo_rig.chain import Model, Stage
from piezo_rig.diagnosis.chances import fisher_above
from piezo_rig.diagnosis.early import noise_floor_nm
from piezo_rig.diagnosis.groups import Group, Groups

FloatArray = NDArray[np.float64]
SETTLING = tuple(np.geomspace(0.5, 20.0, 8))  # times that the slope falls to a third in a session
LEAST = 3  # slopes beyond those that say how steep and how fast
BOTH = 3.0  # times as likely by chance as with the settling given: simulated, 5 to 20 slopes
CHANCE = 0.02  # that slopes settle as well by noise
HALF_WAVES = np.arange(2.0, 8.0)  # over a recording, that slopes are held against
AS_STEEP = 0.01  # chance that slopes are as large by noise


class _Slopes(NamedTuple):
    """Of the recordings of a drive: when each was made, s, and how far its slope is off theirs,
    nm/s; shapes (R,). ``weight`` : one over their variance, but for a factor.
    """

    at_s: FloatArray
    off: FloatArray
    weight: float


def without_settling(groups: Groups, model: Model) -> Groups:
    """Recordings as they are to be compared for their noise: without what a drift that settles
    makes repeats differ by, if one shows.

    Slopes of a recording against the mean of its drive's, beside shares of the displacement, are
    fitted by an exponential in the time of the session. Noise has slopes as well, but not in that
    order (Fisher's law).

    Parameters
    ----------
    model : predicts how the displacement goes
    """
    slopes = [s for g in groups.groups if (s := _slopes(g, model)) is not None]
    count = sum(s.off.size - 1 for s in slopes)
    if count < LEAST + 2 or groups.session_s <= 0.0:
        return _as_steep(groups, model)
    fits = [_fitted(slopes, n / groups.session_s) for n in SETTLING]
    left, rate, settling = min(fits)
    whole = sum(s.weight * float(s.off @ s.off) for s in slopes)
    free = count - 1.0
    ratio = (whole - left) / max(left / free, 1e-300)
    if BOTH * fisher_above(ratio, 1.0, free) > CHANCE:
        return _as_steep(groups, model)
    drift = ThermalDrift.of(None, rate=rate, settling=settling)
    settled = groups.with_([_at_one_time(g, drift) for g in groups.groups])
    return _as_steep(settled, model)


def _slopes(group: Group, model: Model) -> _Slopes | None:
    """Of what is known of the memory of; None of a drive that was recorded once."""
    if group.repeats < 2:
        return None
    time, columns, off = _apart(group, model)
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)  # the drive may stand still
    slopes = 1e3 * np.linalg.lstsq(columns / size, off.T)[0][1] / size[1]
    middle = group.starts_s - group.begun_s + 0.5 * (time[0] + time[-1])
    return _Slopes(middle, slopes, float(np.ptp(time) ** 2))


def _apart(group: Group, model: Model) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times, s (n,); a constant, time and displacement (n, 3); how far the recordings are off
    their mean, um (R, n).
    """
    known = slice(group.blocks[0][0], group.blocks[-1][1])
    time, moved = group.time_s[known], group.predicted(model)[known]
    columns = np.column_stack([np.ones(time.size), time - time.mean(), moved - moved.mean()])
    return time, columns, (group.measured_um - group.measured_um.mean(axis=0))[:, known]


def _as_steep(groups: Groups, model: Model) -> Groups:
    """Recordings with the mean slope of their drive's, if theirs are no slow noise.

    Where they are too few to say how a drift settles, or it goes to and fro, they still say whether
    their slopes are of the noise: half waves over the recording are what it has besides. Of a zero
    that walks at random slopes are as large as those, each times its number; of any faster noise
    they are smaller.
    """
    found = drifting(groups, model)
    return groups if found is None or found.p_value > AS_STEEP else found.straight


@dataclass(frozen=True, eq=False)
class Drifting:
    """How recordings of one drive differ by straight lines, of ``rate_nm_s`` and ``rms_nm``.

    ``p_value`` : that they are as steep by noise
    ``noise_nm`` : by which they differ besides
    ``straight`` : the recordings with the mean slope of their drive's
    """

    p_value: float
    rate_nm_s: float
    rms_nm: float
    noise_nm: float
    straight: Groups


def drifting(groups: Groups, model: Model) -> Drifting | None:
    """None without repeats."""
    slope = noise = square = 0.0
    count, recordings, straight = 0, 0, list[Group]()
    for group in groups.groups:
        if group.repeats < 2:
            straight.append(group)
            continue
        time, columns, off = _apart(group, model)
        span = max(float(np.ptp(time)), 1e-300)
        waves = np.cos(np.pi * np.outer((time - time[0]) / span, HALF_WAVES))
        base, _ = np.linalg.qr(columns[:, [0, 2, 1]])
        own = waves - base @ (base.T @ waves)
        rest, _ = np.linalg.qr(own / np.linalg.norm(own, axis=0))
        along = off @ base[:, 2]
        slope += float(along @ along)
        noise += float(np.sum((off @ rest * HALF_WAVES) ** 2)) / HALF_WAVES.size
        count += group.repeats - 1
        rates = along / (columns[:, 1] @ base[:, 2])
        recordings, square = recordings + group.repeats, square + float(rates @ rates)
        by = np.outer(rates, group.time_s - time.mean())
        straight.append(group.with_measured(group.measured_um - by))
    if count == 0:
        return None
    free, alike = float(count * HALF_WAVES.size), groups.with_(straight)
    chance = float(fisher_above(slope / max(noise, 1e-300), float(count), free))
    before, after = noise_floor_nm(groups) or 0.0, noise_floor_nm(alike) or 0.0
    rms_nm = float(np.sqrt(max(before**2 - after**2, 0.0)))
    return Drifting(chance, 1e3 * float(np.sqrt(square / recordings)), rms_nm, after, alike)


def _fitted(slopes: list[_Slopes], settling: float) -> tuple[float, float, float]:
    """Weighted squares that are left, the rate at the session's begin, nm/s, and the settling."""
    above = below = 0.0
    each = [np.exp(-settling * s.at_s) for s in slopes]
    each = [e - e.mean() for e in each]
    for s, e in zip(slopes, each, strict=True):
        above += s.weight * float(e @ s.off)
        below += s.weight * float(e @ e)
    rate = above / max(below, 1e-300)
    left = sum(
        s.weight * float(np.sum((s.off - rate * e) ** 2)) for s, e in zip(slopes, each, strict=True)
    )
    return left, rate, settling


def _at_one_time(group: Group, drift: Stage) -> Group:
    """As if the recordings had been made at the mean of their times, as far as a drift goes."""
    own = np.array([
        added_by(drift, group.time_s + start - group.begun_s, group.drive_v)
        for start in group.starts_s
    ])  # fmt: skip
    return group.with_measured(group.measured_um - own + own.mean(axis=0))
