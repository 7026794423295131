"""Actuators of other families, and drives as other people play them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np


def bouc_wen(time, drive, gain=0.15, alpha=0.6, beta=0.04, gamma=0.02):
    """d x (V) - h; h' = alpha x' - beta |x'| h - gamma x' |h|, by small steps."""
    h, out = 0.0, np.empty(drive.size)
    out[0] = 0.0
    steps = np.diff(drive)
    for i, dv in enumerate(steps):
        for _ in range(4):
            d = dv / 4
            h += alpha * d - beta * abs(d) * h - gamma * d * abs(h)
        out[i + 1] = gain * ((drive[i + 1] - drive[0]) - 0.3 * h)
    return out


def preisach(time, drive, size=40, gain=12.0):
    """Relays on a triangle of thresholds, and a line."""
    low, high = drive.min(), drive.max()
    edges = np.linspace(low - 0.1, high + 0.1, size)
    down, up = np.meshgrid(edges, edges)
    use = up >= down
    weight = np.exp(-((up - down) / (high - low)) * 2.0)[use]
    down, up = down[use], up[use]
    on = up + down < 2 * drive[0]
    out = np.empty(drive.size)
    for i, v in enumerate(drive):
        on = (on | (v >= up)) & ~(v <= down)
        out[i] = weight @ on
    return gain * (0.5 * out / weight.sum() + 0.5 * (drive - low) / (high - low))


def duhem(time, drive, gain=0.1, rate=0.05):
    """Duhem: y' = c |x'| (a x - y) + b x'."""
    y, out = gain * drive[0], np.empty(drive.size)
    out[0] = y
    for i, dv in enumerate(np.diff(drive)):
        y += rate * abs(dv) * (gain * 1.4 * drive[i + 1] - y) + 0.8 * gain * dv
        out[i + 1] = y
    return out


def backlash(time, drive, gain=0.1, width=0.08):
    """One play as wide as a share of the drive's range, and a line."""
    r = width * np.ptp(drive)
    state, out = drive[0], np.empty(drive.size)
    for i, v in enumerate(drive):
        state = min(max(state, v - r), v + r)
        out[i] = gain * (0.7 * v + 0.3 * state)
    return out


def linear(time, drive, gain=0.1):
    return gain * drive


FAMILIES = {f.__name__: f for f in (bouc_wen, preisach, duhem, backlash, linear)}


def sine(low, high, hz=20.0, rate=10_000.0, cycles=10, phase=-0.5 * np.pi):
    t = np.arange(int(cycles * rate / hz)) / rate
    return t, 0.5 * (low + high) + 0.5 * (high - low) * np.sin(2 * np.pi * hz * t + phase)


def growing(top, hz=20.0, rate=10_000.0, cycles=10):
    t = np.arange(int(cycles * rate / hz)) / rate
    return t, top * (t / t[-1]) * np.sin(2 * np.pi * hz * t)


def minor_loops(low, high, rate=1000.0, seconds=6.0):
    t = np.arange(int(seconds * rate)) / rate
    v = 0.6 * np.sin(2 * np.pi * 0.5 * t - 0.5 * np.pi) + 0.4 * np.sin(2 * np.pi * 3.7 * t)
    return t, low + (high - low) * (v - v.min()) / np.ptp(v)


def steps_and_holds(low, high, rate=1000.0, seed=0):
    rng = np.random.default_rng(seed)
    levels = np.concatenate([[low], rng.uniform(low, high, 14), [high, low, high, low]])
    parts = [
        np.concatenate([np.linspace(a, b, 40), np.full(75, b)]) for a, b in pairwise(levels)
    ]
    v = np.concatenate(parts)
    return np.arange(v.size) / rate, v
