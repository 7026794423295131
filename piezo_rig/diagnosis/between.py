"""Turning points that fall between samples.

A model takes the drive for straight between samples. A triangle that turns between two of them goes
further than either says, and the actuator remembers from where it turned: every half loop after it
lies beside the model by a nanometre or so, and stages of the drive (a lag) by several just after
the corner. Where the straight lines before and after a turning point meet, the drive turned, unless
the generator plays the very samples that are recorded: the data say which.
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
STRAIGHT = 0.02  # change of the drive per sample, by which it may change on a straight line
INSIDE = 0.02  # of a sample, by which a turning point must be away from one
SEEN = 5.0  # times what noise would do, for a look at what they are worth
PLAINLY = 10.0  # log-likelihood


class Denser(NamedTuple):
    """A drive with its turning points between samples, and which samples are given, (n + k,)."""

    time_s: FloatArray
    drive_v: FloatArray
    given: NDArray[np.bool_]

    def before(self, end_s: float) -> Denser:
        """Up to and with a sample at that time."""
        kept = self.time_s <= end_s
        return Denser(self.time_s[kept], self.drive_v[kept], self.given[kept])


def denser(time_s: FloatArray, drive_v: FloatArray, model: Model | None = None) -> Denser | None:
    """With the points where straight lines before and after a turning point meet; None where all
    turning points are samples, or nothing is straight.

    Parameters
    ----------
    time_s, drive_v : shape (n,)
    model : whose amplifier may make the drive turn at other times, as at a slew limit
    """
    own = _meet(time_s, drive_v)
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
        both = np.append(own[0], late), np.append(own[1], there)
        order = np.argsort(both[0])
        dense = _with(time_s, drive_v, both[0][order], both[1][order])
    return None if bool(dense.given.all()) else dense


def _meet(time_s: FloatArray, drive_v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Times and volts (k,) between samples where two straight lines meet and the drive turns."""
    change = np.diff(drive_v)
    at = np.arange(2, change.size - 2)
    before, after = change[at - 1], change[at + 1]
    turns = before * after < 0.0
    straight = (np.abs(before - change[at - 2]) < STRAIGHT * np.abs(before)) & (
        np.abs(after - change[at + 2]) < STRAIGHT * np.abs(after)
    )
    at = at[turns & straight]
    before, after = change[at - 1], change[at + 1]
    # from this sample on along the one line, and to the next one along the other
    share = (change[at] - after) / (before - after)
    inside = (share > INSIDE) & (share < 1.0 - INSIDE)
    at, before, share = at[inside], before[inside], share[inside]
    return time_s[at] + share * (time_s[at + 1] - time_s[at]), drive_v[at] + share * before


def _with(
    time_s: FloatArray, drive_v: FloatArray, more_s: FloatArray, more_v: FloatArray
) -> Denser:
    at = np.searchsorted(time_s, more_s)
    given = np.insert(np.ones(time_s.size, bool), at, False)
    return Denser(np.insert(time_s, at, more_s), np.insert(drive_v, at, more_v), given)


def turn_between(space: Space, fitted: Fitted) -> bool:
    """Whether a fit is plainly better with turning points between samples where they may be."""
    from piezo_rig.diagnosis.engine import space_of
    from piezo_rig.diagnosis.forms import converged
    from piezo_rig.diagnosis.refit import refit

    known = any(g.denser is not None for g in space.groups.groups)
    turned = None if known else space.groups.turned(fitted.point.model)
    if turned is None or not _shows(space, turned, fitted):
        return False
    there = space_of(turned, space.whitener, fitted.point.model)[0]
    there.own_um, there.loose = space.own_um, space.loose
    other = converged(there, refit(there, fitted.point, held=True))
    same = converged(space, refit(space, fitted.point, held=True))
    return other.evidence > same.evidence + PLAINLY


def _shows(space: Space, turned: Groups, fitted: Fitted) -> bool:
    """Whether it can matter: what it does to the displacement, by the noise of a sample."""
    square = 0.0
    for g, t in zip(space.groups.groups, turned.groups, strict=True):
        off = t.predicted(fitted.point.model) - g.predicted(fitted.point.model)
        square += g.repeats * sum(
            float(np.sum(np.square(off[a:b] - off[a:b].mean()))) for a, b in g.blocks
        )
    return 1e3 * float(np.sqrt(square)) > SEEN * space.sample_noise_nm
