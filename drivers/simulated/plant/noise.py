"""Random numbers that are a function of their place, not of the order of asking.

A counter-based generator (SplitMix64, Steele et al., OOPSLA 2014) turns
(seed, stream, index) into a number, so a record may be asked for in pieces, twice,
or at another rate, and shows the same noise. Streams keep the kinds apart.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WHITE, AR, OUTLIER, WALK, JUMP, HUM, DROP, ONE_OVER_F = 1, 2, 3, 4, 5, 6, 7, 64
# Knots of the 1/f noise: 0.2 ms and 17 doublings of it, 26 s.
FINEST_KNOT_S = 2.0e-4
OCTAVES = 18
# Octaves slower than a 5 s sweep are an offset in it, not noise; a linear
# interpolation between independent knots keeps 2/3 of their variance.
OCTAVES_IN_A_SWEEP = 14.6
KEPT_BY_INTERPOLATION = 2.0 / 3.0


@numba.njit(cache=True, inline="always")
def _mix(z):
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@numba.njit(cache=True, error_model="numpy")
def _key(seed, stream, rate):
    z = _mix(np.uint64(seed) + np.uint64(0x9E3779B97F4A7C15))
    z = _mix(z ^ (np.uint64(stream) * np.uint64(0xD1342543DE82EF95)))
    # Signed, because it passes through the interpreter.
    return np.int64(_mix(z + np.uint64(round(rate * 1000.0))))


@numba.njit(cache=True, inline="always")
def _uniform(key, index):
    z = _mix(np.uint64(key) + (np.uint64(index) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15))
    return (float(z >> np.uint64(11)) + 0.5) * (1.0 / 9007199254740992.0)


@numba.njit(cache=True, error_model="numpy")
def _normals(key, start, count):
    """Standard normals number start .. start + count - 1, two per Box-Muller pair."""
    out = np.empty(count)
    first = start - (start & 1)
    for m in range(first, start + count, 2):
        radius = math.sqrt(-2.0 * math.log(_uniform(key, m)))
        angle = 2.0 * math.pi * _uniform(key, m + 1)
        if m >= start:
            out[m - start] = radius * math.cos(angle)
        if m + 1 < start + count:
            out[m + 1 - start] = radius * math.sin(angle)
    return out


@numba.njit(cache=True, error_model="numpy")
def _add_white(x, rms, key, tick):
    x += rms * _normals(key, tick, x.size)


@numba.njit(cache=True, error_model="numpy")
def _add_ar(x, rms, coefficient, key, tick, warm_up):
    fresh = _normals(key, tick - warm_up, x.size + warm_up)
    innovation = rms * math.sqrt(1.0 - coefficient * coefficient)
    state = 0.0
    for i in range(fresh.size):
        state = coefficient * state + innovation * fresh[i]
        if i >= warm_up:
            x[i - warm_up] += state


@numba.njit(cache=True, error_model="numpy")
def _add_knots(x, t, key, spacing, phase, rms):
    density = 1.0 / spacing
    first = math.floor(t[0] * density + phase)
    last = math.floor(t[-1] * density + phase)
    knots = _normals(key, first + 1_000_000, last - first + 2)
    for i in range(x.size):
        place = t[i] * density + phase - first
        k = int(place)
        f = place - k
        x[i] += rms * (knots[k] + f * (knots[k + 1] - knots[k]))


@numba.njit(cache=True, error_model="numpy")
def _add_outliers(x, height, chance, key, tick):
    for i in range(x.size):
        if _uniform(key, 3 * (tick + i)) < chance:
            sign = 1.0 if _uniform(key, 3 * (tick + i) + 1) < 0.5 else -1.0
            x[i] += sign * height * (0.5 + _uniform(key, 3 * (tick + i) + 2))


@numba.njit(cache=True, error_model="numpy")
def _uniforms(key, start, count):
    out = np.empty(count)
    for i in range(count):
        out[i] = _uniform(key, start + i)
    return out


# The numbers are counted from well before bench time 0: a delayed channel, or
# the run-in of a filter, asks for some.
_ORIGIN = 1 << 40


def add_white(x: Array, rms: float, seed: int, tick: int, rate: float) -> None:
    """Add independent Gaussian noise of the given rms to samples tick, tick + 1 ..."""
    _add_white(x, rms, _key(seed, WHITE, rate), tick + _ORIGIN)


def add_ar(x: Array, rms: float, coefficient: float, seed: int, tick: int, rate: float) -> None:
    """Add first-order autoregressive noise of the given stationary rms."""
    warm_up = 0 if coefficient <= 0.0 else math.ceil(math.log(1e-12) / math.log(coefficient))
    _add_ar(x, rms, coefficient, _key(seed, AR, rate), tick + _ORIGIN, warm_up)


def add_one_over_f(x: Array, rms: float, seed: int, t: Array) -> None:
    """Add noise of power 1/f: in each octave independent knots, joined by straight lines.

    An octave of knot spacing T has the spectrum T sinc^4(f T); equal variances in
    every octave add up to 1/f between the slowest and the fastest.
    """
    if not x.size:
        return
    each = rms / math.sqrt(OCTAVES_IN_A_SWEEP * KEPT_BY_INTERPOLATION)
    for octave in range(OCTAVES):
        spacing = FINEST_KNOT_S * 2.0**octave
        key = _key(seed, ONE_OVER_F + octave, 0.0)
        _add_knots(x, t, key, spacing, (0.618034 * (octave + 1)) % 1.0, each)


def add_outliers(x: Array, height: float, chance: float, seed: int, tick: int, rate: float) -> None:
    """Add spikes of 0.5 .. 1.5 times ``height`` to a share ``chance`` of the samples."""
    _add_outliers(x, height, chance, _key(seed, OUTLIER, rate), tick + _ORIGIN)


def random_walk(seed: int, t: Array) -> Array:
    """A random walk (n,) of unit variance per second from bench time 0, linear within seconds."""
    last = max(1, math.ceil(float(np.max(t, initial=0.0))) + 1)
    steps = _normals(_key(seed, WALK, 0.0), 0, last)
    return np.asarray(np.interp(t, np.arange(last + 1), np.concatenate([[0.0], np.cumsum(steps)])))


def random_instants(seed: int, per_second: float, until: float) -> tuple[Array, Array]:
    """Instants in [0, until] at the given rate (at most one a second), and a sign for each."""
    seconds = max(1, math.ceil(until))
    draw = _uniforms(_key(seed, JUMP, 0.0), 0, 3 * seconds).reshape(seconds, 3)
    hit = np.flatnonzero(draw[:, 0] < per_second)
    return hit + draw[hit, 1], np.where(draw[hit, 2] < 0.5, -1.0, 1.0)


def phase(seed: int) -> float:
    """A phase in rad that the seed fixes: the mains' at bench time 0."""
    return float(2.0 * math.pi * _uniforms(_key(seed, HUM, 0.0), 0, 1)[0])


def lost(seed: int, chance: float, tick: int, rate: float, count: int) -> NDArray[np.bool_]:
    """Which of ``count`` samples (from ``tick``) the digitizer loses, each with ``chance``."""
    return np.asarray(_uniforms(_key(seed, DROP, rate), tick + _ORIGIN, count) < chance)
