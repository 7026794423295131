"""A stop operator: how far a signal has come from where it last turned, and no further than so far.

It follows every step of the signal and stands still at either end of its width. It is a state: a
loop of the signal, however small, brings it back to where it was, and so it is with every function
of it (M. Brokate and J. Sprekels, Hysteresis and Phase Transitions, 1996, section 2.3).
"""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, nogil=True)
def stopped(signal, width, first=0.0):
    """The stop (n,) of a signal, within ``width`` to either side; ``first``, of it, at first."""
    out = np.empty(signal.size)
    s = first * width
    for i in range(signal.size):
        if i > 0:
            s = min(max(s + signal[i] - signal[i - 1], -width), width)
        out[i] = s
    return out


@numba.njit(cache=True, nogil=True)
def stopped_each(begins, signal, widths, first=0.0):
    """Mean (n,) of the stops of these widths, of stretches that begin at these samples."""
    out = np.zeros(signal.size)
    for k in range(begins.size):
        a = begins[k]
        b = begins[k + 1] if k + 1 < begins.size else signal.size
        for width in widths:
            out[a:b] += stopped(signal[a:b], width, first)
    return out / widths.size
