"""A stop operator: how far a signal has come from where it last turned, and no further than so far.

It follows every step of the signal and stands still at either end of its width. It is a state: a
loop of the signal, however small, brings it back to where it was, and so it is with every function
of it (M. Brokate and J. Sprekels, Hysteresis and Phase Transitions, 1996, section 2.3).
"""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True, nogil=True, fastmath={"reassoc", "nsz"}, error_model="numpy")
def stopped_each(begins, signal, widths, first=0.0):
    """Mean (n,) of the stops of these widths, of stretches that begin at these samples.

    ``first`` : where each is then, of its width. Many at a time are as quick as a few
    """
    count, out = widths.size, np.empty(signal.size)
    state = np.empty(count)
    for k in range(begins.size):
        a = begins[k]
        b = begins[k + 1] if k + 1 < begins.size else signal.size
        state[:] = first * widths
        for i in range(a, b):
            step = signal[i] - signal[i - 1] if i > a else 0.0
            total = 0.0
            for j in range(count):
                s = state[j] + step
                s = widths[j] if s > widths[j] else s
                s = -widths[j] if s < -widths[j] else s
                state[j] = s
                total += s
            out[i] = total / count
    return out
