"""What a drive does between samples: corners, and what is curved.

A model takes the drive for straight between samples. A triangle that turns between two of them goes
further than either says, and the actuator remembers from where it turned: every half loop after it
lies beside the model by a nanometre or so, and stages of the drive (a lag) by several just after
the corner. Where the straight lines before and after a corner meet, the drive turned, unless
the generator plays the very samples that are recorded: the data say which. A fast sine is off a
straight line all along, by which a lag looks like a delay.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model, Signal

if TYPE_CHECKING:
    from piezo_rig.diagnosis.groups import Groups
    from piezo_rig.diagnosis.refit import Fitted
    from piezo_rig.diagnosis.space import Space

FloatArray = NDArray[np.float64]
Points = tuple[FloatArray, FloatArray]  # times, volts
STRAIGHT = 0.02  # change of the drive per sample, by which it may change on a straight line
BENT = 0.2  # of the larger change, by which it must change at a corner
RUN, LINE = 5, 16  # changes of a line that is only roughly straight: at least, at most
COARSE = 0.25  # of its slope, by which they may differ
CERTAIN = 2.0  # of what they differ by, by which it must bend besides
INSIDE = 0.02  # of a sample, by which a corner must be away from one
CURVED = 5e-5  # of the span, off a straight line between two samples
MOSTLY = 0.3  # of where it bends that it must do so smoothly
LESS = 0.05  # of that: what is curved by less is taken for straight
PARTS = np.array([0.25, 0.5, 0.75])  # of a sample, where a curve is followed
SEEN = 5.0  # times what noise would do, for a look at what they are worth
PLAINLY, BEYOND = 10.0, 50.0  # log-likelihood; beyond another fit, before all else is known
SOME = 0.8  # of what is left beyond the noise


class Denser(NamedTuple):
    """A drive with points between samples, and which samples are given, (n + k,)."""

    time_s: FloatArray
    drive_v: FloatArray
    given: NDArray[np.bool_]

    def before(self, end_s: float) -> Denser:
        """Up to and with a sample at that time."""
        kept = self.time_s <= end_s
        return Denser(self.time_s[kept], self.drive_v[kept], self.given[kept])


def denser(time_s: FloatArray, drive_v: FloatArray, model: Model | None = None) -> Denser | None:
    """With the points where straight lines before and after a corner meet, and those of a curve;
    None where all corners are samples and nothing is curved.

    Parameters
    ----------
    time_s, drive_v : shape (n,)
    model : whose amplifier may make the drive turn at other times, as at a slew limit
    """
    curve, drive_v = _curve(time_s, drive_v)
    own = _joined(_meet(time_s, drive_v), curve)
    dense = _with(time_s, drive_v, *own)
    stages = [s for s in model.stages if s.place == "drive"] if model is not None else []
    if stages:
        signal = Signal(dense.time_s, dense.drive_v, np.zeros(0))
        for stage in stages:
            signal = stage.act(signal)
        late, _ = _meet(time_s, signal.drive_v[dense.given])
        step = INSIDE * float(np.median(np.diff(time_s)))
        late = np.array([t for t in late if not np.any(np.abs(t - own[0]) < step)])
        there = np.interp(late, dense.time_s, dense.drive_v)
        dense = _with(time_s, drive_v, *_joined(own, (late, there)))
    return None if bool(dense.given.all()) else dense


def _meet(time_s: FloatArray, drive_v: FloatArray) -> Points:
    """Times and volts (k,) between samples where two straight lines meet.

    What was rounded when it was recorded is only roughly straight, from sample to sample: lines
    are then drawn through many of them.
    """
    change = np.diff(drive_v)
    if change.size < 2 * RUN + 1:
        return np.zeros(0), np.zeros(0)
    runs = np.lib.stride_tricks.sliding_window_view(change, RUN)
    at = np.arange(RUN, change.size - RUN)
    earlier, later = runs[at - RUN], runs[at + 1]
    before, after = change[at - 1], change[at + 1]
    larger = np.maximum(np.abs(before), np.abs(after))
    bent = np.abs(after - before) > BENT * larger
    straight = (np.abs(before - change[at - 2]) < STRAIGHT * larger) & (
        np.abs(after - change[at + 2]) < STRAIGHT * larger
    )
    mean = np.mean(earlier, axis=1), np.mean(later, axis=1)
    off = np.maximum(np.ptp(earlier, axis=1), np.ptp(later, axis=1))
    most = np.maximum(np.abs(mean[0]), np.abs(mean[1]))
    roughly = ~straight & (off < COARSE * most) & (
        np.abs(mean[1] - mean[0]) > BENT * most + CERTAIN * off
    )
    kept = (bent & straight) | roughly
    at, before, after, roughly, off = at[kept], before[kept], after[kept], roughly[kept], off[kept]
    first, last = drive_v[at], drive_v[at + 1]
    for k in np.flatnonzero(roughly):
        backwards, first[k] = _line(drive_v[max(at[k] - LINE, 0) : at[k] + 1][::-1], off[k])
        before[k] = -backwards
        after[k], last[k] = _line(drive_v[at[k] + 1 : at[k] + 2 + LINE], off[k])
    # from this sample on along the one line, and to the next one along the other
    share = (last - first - after) / (before - after)
    inside = (share > INSIDE) & (share < 1.0 - INSIDE)
    at, before, share, first = at[inside], before[inside], share[inside], first[inside]
    return time_s[at] + share * (time_s[at + 1] - time_s[at]), first + share * before


def _line(volts: FloatArray, off: float) -> tuple[float, float]:
    """Slope of the roughly straight line that samples (n,) begin with, and its value at the first.
    """
    change = np.diff(volts)
    bent = np.abs(change - np.mean(change[:RUN])) > 2.0 * off
    straight = max(int(np.argmax(bent)) if bent.any() else change.size, RUN)
    slope, value = np.polyfit(np.arange(straight + 1), volts[: straight + 1], 1)
    return float(slope), float(value)


def _curve(time_s: FloatArray, drive_v: FloatArray) -> tuple[Points, FloatArray]:
    """Times and volts (k,) between samples, where a smooth drive is off a straight line; and the
    drive (n,), as little off itself as straight lines between those points are off its mean.

    The least second difference about an interval counts, if all have one sign: at a corner, and
    mostly in noise, they have not.
    """
    bend = np.diff(drive_v, 2)  # about samples 1, 2, ..
    if bend.size < 4:
        return (np.zeros(0), np.zeros(0)), drive_v
    four = np.lib.stride_tricks.sliding_window_view(bend, 4)  # about interval 2, 3, ..
    least = np.where(np.all(four * four[:, :1] > 0.0, axis=1), np.min(np.abs(four), axis=1), 0.0)
    most, largest = float(least.max()), np.max(np.abs(four), axis=1)
    plain = largest > 8.0 * CURVED * float(np.ptp(drive_v))
    if not np.sum(least[plain] > 0.5 * largest[plain]) > MOSTLY * np.sum(plain):
        return (np.zeros(0), np.zeros(0)), drive_v
    at = np.flatnonzero((least > LESS * most) & (least > LESS * largest)) + 2
    # the third-order curve through four samples
    a, b, c, d = (drive_v[at + k][:, None] for k in (-1, 0, 1, 2))
    s = PARTS
    volts = (
        b + s * (c - b) + s * (s - 1.0) * ((2.0 - s) * (c - 2.0 * b + a)
                                           + (1.0 + s) * (d - 2.0 * c + b)) / 6.0
    )  # fmt: skip
    times = time_s[at][:, None] + s * (time_s[at + 1] - time_s[at])[:, None]
    # lines between points of a curve are off its mean by a twelfth of their second difference
    off = 0.5 * (bend[at - 1] + bend[at]) / (12.0 * (s.size + 1) ** 2)
    shifted = drive_v.copy()
    np.add.at(shifted, at, -0.5 * off)
    np.add.at(shifted, at + 1, -0.5 * off)
    return (times.ravel(), (volts - off[:, None]).ravel()), shifted


def _joined(some: Points, others: Points) -> Points:
    """Both, in time."""
    times, volts = (np.append(x, y) for x, y in zip(some, others, strict=True))
    order = np.argsort(times)
    return times[order], volts[order]


def _with(
    time_s: FloatArray, drive_v: FloatArray, more_s: FloatArray, more_v: FloatArray
) -> Denser:
    at = np.searchsorted(time_s, more_s)
    given = np.insert(np.ones(time_s.size, bool), at, False)
    return Denser(np.insert(time_s, at, more_s), np.insert(drive_v, at, more_v), given)


def turn_between(
    space: Space, fitted: Fitted, less: Fitted | None = None, weary: bool = False,
    best: Fitted | None = None,
) -> bool:  # fmt: skip
    """Whether a fit is plainly better with corners and curves between samples, where they may be.

    ``less`` : the same without its only member; with them it may be as good: a lag of a
    fraction of a sample does much of what a corner does that is not put in. Where much else is
    missing, that is told when it is not: what cuts off corners looks like another corner
    ``weary`` : whether much was tried already, and something is left; to begin anew then asks for
    corners that explain some of that
    ``best`` : another fit of the same recordings, which is to be improved on far; what lacks half
    of what is there is as good with corners as with the other half, and all is asked once more
    """
    from piezo_rig.diagnosis.engine import space_of
    from piezo_rig.diagnosis.forms import converged
    from piezo_rig.diagnosis.put_in import much_left
    from piezo_rig.diagnosis.refit import refit

    known = any(g.denser is not None for g in space.groups.groups)
    turned = None if known else space.groups.turned(fitted.point.model)
    if turned is None or not _shows(space, turned, fitted):
        return False
    there = space_of(turned, space.whitener, fitted.point.model)[0]
    there.own_um, there.loose = space.own_um, space.loose
    same = converged(space, refit(space, fitted.point, held=True))
    said = same.evidence
    if best is not None and best is not fitted:
        said = max(said, best.evidence + BEYOND - PLAINLY)
    if less is not None:
        without = converged(there, refit(there, less.point, held=True))
        better = without.evidence > said - PLAINLY or _left(without) < _left(same)
        if better and not much_left(there, without):
            return True
    other = converged(there, refit(there, fitted.point, held=True))
    if less is not None and much_left(there, other):
        return False
    if weary and _beyond(there, other) > SOME * _beyond(space, same):
        return False
    return other.evidence > said + PLAINLY


def _beyond(space: Space, fitted: Fitted) -> float:
    """Mean squared error beyond the noise, thinned as the recordings are, nm^2."""
    mean = 1e6 * _left(fitted) / max(float(fitted.linear.count.sum()), 1.0)
    return float(max(mean - space.noise_nm**2, 0.0))


def _left(fitted: Fitted) -> float:
    """Squared error over all samples, um^2."""
    return float(fitted.linear.raw_residual[:, -1].sum())


def _shows(space: Space, turned: Groups, fitted: Fitted) -> bool:
    """Whether it can matter: what it does to the displacement, by the noise of a sample."""
    square = 0.0
    for g, t in zip(space.groups.groups, turned.groups, strict=True):
        off = t.predicted(fitted.point.model) - g.predicted(fitted.point.model)
        square += g.repeats * sum(
            float(np.sum(np.square(off[a:b] - off[a:b].mean()))) for a, b in g.blocks
        )
    return 1e3 * float(np.sqrt(square)) > SEEN * space.sample_noise_nm
