"""What every half loop gains at first and has given back where the one before it began.

A function of the signal's memory: turning points are kept until the signal comes back to them
(Madelung's rules, thesis section 2.2), and a loop that comes back to where it left another half
loop has there what it had then, whatever it did in between.
"""

from __future__ import annotations

import numba
import numpy as np

DEEPEST = 20  # loops inside each other, twice; of more the innermost are forgotten
CLOSED = 1e-9  # of a loop: rounding does not decide whether it has been closed


@numba.njit(cache=True, nogil=True, error_model="numpy")
def gained(moved, reach, whole):
    """Of a half loop that has moved so far, of the whole way to where the one before it began."""
    if not whole > 0.0:
        return 0.0
    return reach * (1.0 - np.exp(-moved / reach)) * (1.0 - moved / whole)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def is_back(x, there, since, way):
    """Whether a signal that turned at ``since`` is back at ``there``."""
    return (x - there) * way >= -CLOSED * abs(there - since)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def given_back_each(begins, signal, reach):
    """Shape (n,), of stretches that begin virgin at these samples: what is gained on both ways.

    A first rise gains nothing, nor does whatever goes beyond all that went before. Right after a
    turning point what is gained grows as the signal moves; over ``reach`` it comes to rest.
    """
    out = np.zeros(signal.size)
    at, had = np.empty(DEEPEST + 1), np.empty(DEEPEST + 1)  # of turning points, the latest last
    for k in range(begins.size):
        a = begins[k]
        b = begins[k + 1] if k + 1 < begins.size else signal.size
        if b <= a:
            continue
        at[0], had[0], depth, way, beyond = signal[a], 0.0, 1, 0.0, 0.0
        for i in range(a + 1, b):
            step = signal[i] - signal[i - 1]
            if step * way < 0.0:
                if depth > DEEPEST - 1:
                    depth -= 2
                at[depth], had[depth] = signal[i - 1], out[i - 1]
                depth += 1
            if step != 0.0:
                way = 1.0 if step > 0.0 else -1.0
            while depth > 2 and is_back(signal[i], at[depth - 2], at[depth - 1], way):
                depth -= 2
            if depth == 2 and is_back(signal[i], at[0], at[1], way):
                beyond, depth = had[0], 1
                at[0], had[0] = at[1], had[1]
            if depth == 1:
                out[i] = beyond
                continue
            moved, whole = abs(signal[i] - at[depth - 1]), abs(at[depth - 2] - at[depth - 1])
            back = had[depth - 2] - had[depth - 1]
            out[i] = had[depth - 1] + back * moved / whole + gained(moved, reach, whole)
    return out
