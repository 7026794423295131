"""What is played: conditions with their drives, at a rate that keeps a case small."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

FloatArray = NDArray[np.float64]
MOST = 50_000  # samples of a case, repeats included
RATES = (5000.0, 4000.0, 2000.0, 1000.0)
SLEW = 300.0  # V/s to the first drive of a sweep that does not begin at 0 V
FULL = 75.0
ONE_SWEEP = 24.0  # s of protocols that are one sweep, all recordings together
SHORTEST_V = 8.0  # line between random turning points


@dataclass(frozen=True, eq=False)
class Condition:
    """One condition as it is played: ``drive_v`` (n,) at ``rate`` per second, from rest."""

    name: str
    rate: float
    drive_v: FloatArray

    @property
    def time_s(self) -> FloatArray:
        return np.arange(self.drive_v.size) / self.rate


Shape = tuple[str, Callable[[float], FloatArray]]  # name, rate -> drive


def conditions_of(protocol: str, rng: np.random.Generator, repeats: int) -> list[Condition]:
    """A protocol drawn at random, with the highest rate at which it stays small.

    Raises
    ------
    ValueError : no such protocol
    """
    if protocol not in PROTOCOLS:
        raise ValueError(f"protocol {protocol!r} is not one of {', '.join(PROTOCOLS)}")
    shapes = _SHAPES[protocol](rng, repeats)
    for rate in RATES:
        drives = [make(rate) for _, make in shapes]
        if repeats * sum(d.size for d in drives) <= MOST:
            break
    return [Condition(name, rate, d) for (name, _), d in zip(shapes, drives, strict=True)]


def lines(rate: float, turns: Sequence[float], seconds: Sequence[float]) -> FloatArray:
    """Straight lines through turning points; each takes about so many seconds."""
    parts = [np.array([float(turns[0])])]
    for a, b, s in zip(turns[:-1], turns[1:], seconds, strict=True):
        n = max(round(s * rate), 1)
        parts.append(a + (b - a) * np.arange(1, n + 1) / n)
        parts[-1][-1] = b
    return np.concatenate(parts)


def triangle(low: float, high: float, hz: float, cycles: int) -> Callable[[float], FloatArray]:
    """From 0 V; a sweep between others rises at 300 V/s first and falls at the end."""

    def make(rate: float) -> FloatArray:
        half = 0.5 / hz
        if low == 0.0:
            return lines(rate, [0.0] + [high, 0.0] * cycles, [half] * (2 * cycles))
        turns = [0.0, high] + [low, high] * cycles + [0.0]
        rise = high / SLEW
        return lines(rate, turns, [rise] + [half] * (2 * cycles) + [rise])

    return make


def constant_slew(turns: Sequence[float], slew: float) -> Callable[[float], FloatArray]:
    """Turning points at one slew rate."""
    seconds = [abs(b - a) / slew for a, b in pairwise(turns)]
    return lambda rate: lines(rate, turns, seconds)


def _matrix(rng: np.random.Generator, repeats: int) -> list[Shape]:
    up = sorted(rng.choice(np.arange(10, 75, 5), int(rng.integers(3, 5)), replace=False))
    down = sorted(rng.choice(np.arange(5, 70, 5), int(rng.integers(2, 4)), replace=False))[::-1]
    out: list[Shape] = [(f"0-{v}", triangle(0.0, float(v), 2.0, 3)) for v in [*up, 75]]
    return out + [(f"75-{v}", triangle(float(v), FULL, 2.0, 3)) for v in down]


def _shuffled(rng: np.random.Generator, repeats: int) -> list[Shape]:
    shapes = _matrix(rng, repeats)
    return [shapes[i] for i in rng.permutation(len(shapes))]


def _rates(rng: np.random.Generator, repeats: int) -> list[Shape]:
    big = float(rng.choice([50, 60, 75]))
    small = float(rng.choice([20, 25, 30]))
    plan = [(big, 0.5, 1), (small, 1.0, 2), (big, 2.0, 3), (small, 5.0, 4), (big, 10.0, 5),
            (small, 20.0, 8), (big, float(rng.choice([4.0, 5.0])), 3)]  # fmt: skip
    order = rng.permutation(len(plan))
    return [(f"0-{v:g} at {hz:g} Hz", triangle(0.0, v, hz, cycles))
            for v, hz, cycles in (plan[i] for i in order)]  # fmt: skip


def _holds(rng: np.random.Generator, repeats: int) -> list[Shape]:
    slew = float(rng.choice([150.0, 200.0, 300.0]))
    count = max(4 - repeats, 1)
    plain = [[0.0, 75.0, 0.0, 75.0, 0.0], [0.0, 30.0, 0.0, 30.0, 0.0]][: 3 - repeats // 3]
    held = []
    for _ in range(count):
        top, low = float(rng.uniform(40, 75)), float(rng.uniform(5, 30))
        held.append([0.0, top, top, low, top, 0.0, 0.0])
    moving = sum(float(np.abs(np.diff(t)).sum()) for t in [*plain, *held]) / slew
    left = 0.97 * MOST / repeats / RATES[-1] - moving  # seconds of holds and rests
    shares = np.array([1.3, 1.0, 0.7])[:count]
    shares = rng.permutation(shares / shares.sum())
    out: list[Shape] = []
    for k, (turns, share) in enumerate(zip(held, shares, strict=True)):
        hold = float(np.clip(share * left * rng.uniform(0.55, 0.7), 5.0, 20.0))
        rest = float(np.clip(share * left - hold, 1.0, 20.0))
        moves = np.abs(np.diff(turns)) / slew
        out.append((f"hold {k + 1}", _held(turns, [moves[0], hold, *moves[2:5], rest])))
    names = ("0-75", "0-30")
    return out + [(n, constant_slew(t, slew)) for n, t in zip(names, plain, strict=False)]


def _held(turns: Sequence[float], seconds: Sequence[float]) -> Callable[[float], FloatArray]:
    return lambda rate: lines(rate, turns, seconds)


def _sines(rng: np.random.Generator, repeats: int) -> list[Shape]:
    out: list[Shape] = []
    cycles = 6
    amplitudes = np.append(np.sort(rng.uniform(4.0, 35.0, 4)), rng.uniform(36.0, 50.0))
    for hz in rng.choice([20.0, 25.0, 40.0, 50.0, 80.0, 100.0], 2, replace=False):

        def growing(rate: float, hz: float = float(hz)) -> FloatArray:
            n = round(rate / hz)
            wave = np.sin(2.0 * np.pi * np.arange(1, cycles * n + 1) / n)
            wave[np.arange(n // 2 - 1, wave.size, n // 2)] *= n % 2  # exact zeros
            return np.concatenate([[0.0], *(float(a) * wave for a in amplitudes)])

        out.append((f"growing sine {hz:g} Hz", growing))
    hz = float(rng.choice([30.0, 60.0]))
    for a in amplitudes[[1, 4]]:
        out.append((f"+-{a:.1f} at {hz:g} Hz", _sine(float(a), hz, 15)))
    return out


def _sine(amplitude: float, hz: float, cycles: int) -> Callable[[float], FloatArray]:
    def make(rate: float) -> FloatArray:
        n = round(cycles * rate / hz)
        return amplitude * np.sin(2.0 * np.pi * hz * np.arange(n + 1) / rate)

    return make


def _minor(rng: np.random.Generator, repeats: int) -> list[Shape]:
    out: list[Shape] = []
    for k in range(int(rng.integers(4, 7))):
        slew = float(rng.uniform(150.0, 400.0))
        count = int(rng.integers(10, 16))
        inside = rng.uniform(0.0, FULL, count)
        up = inside[0] < 0.5 * FULL
        turns = [0.0]
        for v in inside:  # alternate between a lower and an upper half, overlapping
            turns.append(float(0.35 * FULL + 0.65 * v if up else 0.65 * v))
            up = not up
        keep = [0.0] + [b for a, b in pairwise(turns) if abs(b - a) > 2.0]
        out.append((f"minor loops {k + 1}", constant_slew([*keep, 0.0], slew)))
    return out


def _one(rng: np.random.Generator, repeats: int) -> list[Shape]:
    high, hz = float(np.round(rng.uniform(45.0, FULL), 1)), float(rng.choice([1.0, 2.0, 4.0]))
    seconds = ONE_SWEEP / repeats
    return [(f"0-{high:g} at {hz:g} Hz", triangle(0.0, high, hz, round(seconds * hz)))]


def _ramps(rng: np.random.Generator, repeats: int) -> list[Shape]:
    """One sweep of lines between random turning points, at three slew rates."""
    slews = rng.choice([60.0, 120.0, 250.0, 400.0, 700.0], 3, replace=False)
    turns, seconds, up = [0.0], list[float](), True
    while sum(seconds) < ONE_SWEEP / repeats:
        at = turns[-1]
        room = FULL - at if up else at
        if room > 2.0 * SHORTEST_V:
            step = float(rng.uniform(SHORTEST_V, room))
            turns.append(at + step if up else at - step)
            seconds.append(step / float(rng.choice(slews)))
        up = not up
    seconds.append(turns[-1] / float(slews[0]))
    return [("ramps", _held([*turns, 0.0], seconds))]


def _walk(rng: np.random.Generator, repeats: int) -> list[Shape]:
    """One smooth sweep through random drives, from rest and back to it."""
    seconds = ONE_SWEEP / repeats
    every = 1.0 / float(rng.choice([6.0, 12.0, 25.0]))  # s between the drives
    at = np.append(np.arange(0.0, seconds, every), seconds)
    through = rng.uniform(0.0, 1.0, at.size)
    through = np.convolve(through, np.ones(2) / 2.0, "same")
    through = float(rng.uniform(50.0, FULL)) * (through - through.min()) / np.ptp(through)
    through[[0, 1, -2, -1]] = 0.0
    smooth = PchipInterpolator(at, through)
    return [("walk", lambda rate: np.asarray(smooth(_clock(seconds, rate)), float))]


def _multisine(rng: np.random.Generator, repeats: int) -> list[Shape]:
    """Four sines at once, faded in and out; with ``repeats`` as with any other condition."""
    seconds, high = ONE_SWEEP / repeats, float(rng.uniform(50.0, FULL))
    hz, phase = rng.uniform(0.5, 10.0, 4), rng.uniform(0.0, 2.0 * np.pi, 4)
    share = rng.uniform(0.5, 1.0, 4)
    share *= 0.5 / share.sum()

    def make(rate: float) -> FloatArray:
        t = _clock(seconds, rate)
        waves = share @ np.sin(2.0 * np.pi * np.outer(hz, t) + phase[:, None])
        near = np.clip(np.minimum(t, seconds - t) / 0.6, 0.0, 1.0)
        return np.asarray(high * near**2 * (3.0 - 2.0 * near) * (0.5 + waves), float)

    return [("multisine", make)]


def _chirp(rng: np.random.Generator, repeats: int) -> list[Shape]:
    seconds, high = ONE_SWEEP / repeats, float(rng.uniform(50.0, FULL))
    first, last = 0.5, float(rng.choice([10.0, 20.0, 40.0]))

    def make(rate: float) -> FloatArray:
        t, grown = _clock(seconds, rate), np.log(last / first)
        turned = 2.0 * np.pi * first * seconds / grown * np.expm1(grown * t / seconds)
        return np.asarray(high * 0.5 * (1.0 - np.cos(turned)), float)

    return [("chirp", make)]


def _clock(seconds: float, rate: float) -> FloatArray:
    return np.arange(round(seconds * rate) + 1) / rate


_SHAPES: dict[str, Callable[[np.random.Generator, int], list[Shape]]] = {
    "matrix": _matrix, "shuffled": _shuffled, "rates": _rates, "holds": _holds,
    "bipolar_sine": _sines, "minor_loops": _minor,
    "one": _one, "ramps": _ramps, "walk": _walk, "multisine": _multisine, "chirp": _chirp,
}  # fmt: skip
PROTOCOLS = tuple(_SHAPES)


def unseen_drive(conditions: Sequence[Condition], rng: np.random.Generator) -> FloatArray:
    """Random decaying turning points within the range that was played, at the usual slew."""
    low = min(float(c.drive_v.min()) for c in conditions)
    high = max(float(c.drive_v.max()) for c in conditions)
    rate = conditions[0].rate
    speeds = np.concatenate([np.abs(np.diff(c.drive_v)) * rate for c in conditions])
    slew = float(np.median(speeds[speeds > 1.0]))
    turns = [0.0]
    swing, up = 0.97, True
    middle = 0.5 * (low + high)
    while swing > 0.12:
        way = 0.5 * (high - low) * (swing * rng.uniform(0.85, 1.0))
        turns.append(middle + way if up else middle - way)
        up, swing = not up, swing * rng.uniform(0.8, 0.97)
    return constant_slew([*turns, 0.0], slew)(rate)
