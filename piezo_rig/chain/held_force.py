"""A first spring that keeps its force where its stiffness changes, as springs and sliders do.

A Maxwell element is a spring in series with a slider: its force grows by its stiffness with every
step of the displacement, until the slider gives way. A law that makes the spring stiffer or softer
at a turning point leaves the force where it is, so that how far it is from there to where it gives
way the other way hangs on its stiffness before as well: (k_before + k_now) dx / k_now. A branch
with one reach (`Reaching`) is that for small changes only.

The other springs are in parallel with it, so that what it holds back is taken off the drive.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
SOFTENED = -0.8  # share of the stiffness at hand that a law takes away, beyond which steps stay


class Springs(NamedTuple):
    """The first spring of every half loop, and the one without the law whose place it takes.

    Attributes
    ----------
    start : shape (m,), sample at which each half loop begins
    stiffness_v_per_um, gives_way_v : shape (m,), and the force at which the slider gives way
    without_v_per_um, without_v : the same of the spring without a law
    """

    start: NDArray[np.int64]
    stiffness_v_per_um: FloatArray
    gives_way_v: FloatArray
    without_v_per_um: float
    without_v: float


def held_v(
    springs: Springs, begins: NDArray[np.int64], drive_v: FloatArray, displacement_um: FloatArray
) -> FloatArray:
    """What the spring holds back more than it would without the law, V, shape (n,).

    Parameters
    ----------
    begins : shape (k,), samples at which stretches begin, without any force
    displacement_um : of the drive (n,) without the law
    """
    return np.asarray(_held(begins, drive_v, displacement_um, *springs))


@numba.njit(cache=True, nogil=True)
def _held(begins, drive, moved, start, stiffness, gives_way, without, without_gives_way):
    """What is held back takes away from the step itself, as long as a slider has not given way."""
    out = np.empty(drive.size)
    loop = 0
    for s in range(begins.size):
        a = begins[s]
        b = begins[s + 1] if s + 1 < begins.size else drive.size
        own = plain = out[a] = 0.0
        for i in range(a + 1, b):
            while loop + 1 < start.size and start[loop + 1] < i:
                loop += 1
            volts, step = drive[i] - drive[i - 1], moved[i] - moved[i - 1]
            way = 1.0 if step > 0.0 else -1.0
            most, plain_most = gives_way[loop], without_gives_way
            k = stiffness[loop] if own * way < most else 0.0
            plain_k = without if plain * way < plain_most else 0.0
            less = (k - plain_k) * step / volts if volts != 0.0 else 0.0
            if less > SOFTENED:
                step /= 1.0 + less
            if k > 0.0:
                own = way * min(way * (own + k * step), most)
            if plain_k > 0.0:
                plain = way * min(way * (plain + plain_k * step), plain_most)
            out[i] = own - plain
    return out
