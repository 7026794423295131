"""What a bench's own record says about a kill: when the stack rested, and how it got there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

REST_V = 0.02
"""Nearer to 0 V than this is rest."""
WINDOW_S = 0.01
"""Slew is the change over this time: the generator moves in steps of 0.15 V."""


@dataclass(frozen=True)
class Verdict:
    """One kill, as the plant saw it.

    Attributes
    ----------
    killed_v : on the stack when the runner was killed
    rest_after_s : from the kill to rest, bench clock
    late_s : from the end of the burst (or the kill, without one) to rest; 0 when in time
    slew_v_per_s : largest change over `WINDOW_S` after the kill
    end_v : on the stack at the end of the record
    """

    killed_v: float
    rest_after_s: float
    late_s: float
    slew_v_per_s: float
    end_v: float


def read_record(path: Path) -> tuple[FloatArray, FloatArray]:
    """``time_s,stack_v`` as the bench wrote them so far; a last line in the making is left out."""
    text = path.read_text(encoding="utf-8")
    lines = text[: text.rfind("\n") + 1].splitlines()[1:]
    rows = np.array([line.split(",") for line in lines], dtype=float).reshape(-1, 2)
    return rows[:, 0], rows[:, 1]


def judge(
    time_s: FloatArray, stack_v: FloatArray, killed_s: float, burst_s: float
) -> Verdict:
    """Look at the stack from the kill on.

    Parameters
    ----------
    killed_s : bench time just before the kill
    burst_s : duration of the burst that was started or under way, 0 for none. It begins where the
        stack last left 0 V
    """
    after = np.append(killed_s, time_s[time_s > killed_s])
    volts = np.interp(after, time_s, stack_v)
    away = np.abs(stack_v) > REST_V
    moving = np.flatnonzero(away & (time_s > killed_s))
    rest_s = killed_s
    due_s = killed_s
    if moving.size:
        last = int(moving[-1])
        rest_s = float(time_s[min(last + 1, time_s.size - 1)])
        before = np.flatnonzero(~away[:last])
        begun_s = float(time_s[before[-1]]) if before.size else 0.0
        if burst_s:
            due_s = max(killed_s, begun_s + burst_s)
    grid = np.arange(killed_s, after[-1], 1e-3)
    even = np.interp(grid, after, volts)
    step = round(WINDOW_S / 1e-3)
    slew = np.abs(even[step:] - even[:-step]) / WINDOW_S
    return Verdict(
        killed_v=float(volts[0]), rest_after_s=rest_s - killed_s, late_s=max(0.0, rest_s - due_s),
        slew_v_per_s=float(slew.max(initial=0.0)), end_v=float(stack_v[-1]),
    )
