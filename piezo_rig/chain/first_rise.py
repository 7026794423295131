"""A first rise with elements of its own, in an actuator that remembers something.

From rest an initiation curve and a virgin memory are one walk. What is left of an earlier
recording takes part in the loops, which know nothing of a first rise; what a first rise is steeper
by is switched once, on the way to every drive that this recording has not reached before. So the
two add up: loops that begin with what is left, and what the initiation curve has beyond theirs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain.branches import Curve

FloatArray = NDArray[np.float64]


def first_rise_um(own: Curve, of_loops: Curve, drive_v: FloatArray, begin: int = 0) -> FloatArray:
    """What an initiation curve adds along a drive to a first rise by the loops' elements, um, (n,).

    Parameters
    ----------
    drive_v : shape (n,), volts
    begin : sample at which the recording begins; before it nothing is added
    """
    reach, sign = reached(drive_v[begin:])
    beyond = _risen(own, reach) - _risen(of_loops, reach)
    out = np.zeros(drive_v.size)
    out[begin:] = np.cumsum(sign * np.diff(beyond, prepend=beyond[:1]))
    return out


def first_rise_v(knots_v: FloatArray, drive_v: FloatArray) -> FloatArray:
    """Way of a first rise on each band up to these knots (k,), volts, shape (k, n).

    Past the last knot its band goes on.
    """
    reach, sign = reached(drive_v)
    begins = np.concatenate([[0.0], knots_v[:-1]])
    ends = np.append(knots_v[:-1], np.inf)
    ways = np.clip(reach, begins[:, None], ends[:, None])
    return np.asarray(np.cumsum(sign * np.diff(ways, axis=1, prepend=ways[:, :1]), axis=1))


def reached(drive_v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How far a drive has been from its first value up to each sample, and to which side it is."""
    away = drive_v - drive_v[0]
    return np.maximum.accumulate(np.abs(away)), np.sign(away)


def _risen(curve: Curve, reach_v: FloatArray) -> FloatArray:
    """Displacement of a curve after so many volts, um."""
    at = np.searchsorted(curve.knots_v, reach_v, side="right")
    begins = np.concatenate([[0.0], curve.knots_v])
    moved = curve.moved_um[at] + (reach_v - begins[at]) * curve.compliance_um_per_v[at]
    return np.asarray(moved)
