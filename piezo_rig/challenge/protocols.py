"""What is played: protocols drawn at random, short enough for many cases.

They have the shapes of the shipped ones: the matrix at 2 Hz, a sweep of rates, holds, and minor
loops. Each of a case's conditions is played twice, always with the history of a virgin actuator.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np

Rng = np.random.Generator
REPEATS = 2


def _text(name: str, rate: int, conditions: list[dict[str, Any]]) -> str:
    lines = ['schema = "piezo-rig/protocol/1"', f'name = "{name}"', f"sample_rate = {rate}",
             f"repeats = {REPEATS}", 'history = "virgin"']  # fmt: skip
    for c in conditions:
        lines += ["", "[[condition]]"]
        lines += [f"{k} = " + (f'"{v}"' if isinstance(v, str) else str(v)) for k, v in c.items()]
    return "\n".join(lines) + "\n"


def _triangle(low: float, high: float, hz: float, cycles: int) -> dict[str, Any]:
    start = "lower" if low == 0 else "upper"
    return {"waveform": "triangle", "lower_v": low, "upper_v": high, "start": start,
            "frequency_hz": hz, "cycles": cycles}  # fmt: skip


def _matrix(rng: Rng) -> str:
    up = sorted(int(v) for v in rng.choice(np.arange(10, 75, 5), 3, replace=False))
    down = sorted((int(v) for v in rng.choice(np.arange(5, 70, 5), 3, replace=False)), reverse=True)
    return _text("matrix", 2000, [_triangle(0, v, 2, 3) for v in [*up, 75]]
                 + [_triangle(v, 75, 2, 3) for v in down])  # fmt: skip


def _rates(rng: Rng) -> str:
    big, small = int(rng.choice([50, 60, 75])), int(rng.choice([20, 25, 30]))
    plan = [(big, 0.5, 1), (small, 1, 2), (big, 2, 3), (small, 5, 4), (big, 10, 5), (small, 20, 8),
            (big, int(rng.choice([4, 5])), 3)]  # fmt: skip
    return _text("rates", 2000, [
        {"name": f"0-{v} at {hz:g} Hz", **_triangle(0, v, hz, cycles)}
        for v, hz, cycles in (plan[i] for i in rng.permutation(len(plan)))
    ])  # fmt: skip


def _holds(rng: Rng) -> str:
    conditions: list[dict[str, Any]] = [_triangle(0, 75, 2, 2), _triangle(0, 30, 2, 2)]
    for k in range(2):
        top, low = int(rng.uniform(40, 75)), int(rng.uniform(5, 30))  # 3 V and below are a rest
        conditions.append({"name": f"hold {k + 1}", "waveform": "steps",
                           "levels_v": [top, low, top, low + 5],
                           "hold_s": round(float(rng.uniform(1.8, 2.6)), 2)})  # fmt: skip
    return _text("holds", 1000, [conditions[i] for i in rng.permutation(4)])


def _minor_loops(rng: Rng) -> str:
    conditions = []
    for k in range(int(rng.integers(4, 6))):
        points, up = [0], bool(rng.uniform() < 0.5)
        for v in rng.uniform(0.0, 75.0, int(rng.integers(10, 16))):
            points.append(round(26.0 + 0.65 * v if up else 0.65 * v))
            up = not up
        kept = [0] + [b for a, b in pairwise(points) if abs(b - a) > 2]
        conditions.append({"name": f"minor loops {k + 1}", "waveform": "turning-points",
                           "points_v": [*kept, 0],
                           "slew_v_per_s": int(rng.uniform(150, 400))})  # fmt: skip
    return _text("minor_loops", 2000, conditions)


_DRAWN: dict[str, Callable[[Rng], str]] = {
    "matrix": _matrix, "rates": _rates, "holds": _holds, "minor_loops": _minor_loops,
}  # fmt: skip
PROTOCOLS = tuple(_DRAWN)


def protocol_text(name: str, rng: Rng) -> str:
    """A protocol file of one of `PROTOCOLS`."""
    return _DRAWN[name](rng)
