"""An actuator and a sensor in plain numpy, for diagnosis: shares no code with the program.

Thresholds are drawn at random, so they lie on no model's grid. Effects are written out here as
their physics says, not taken from the program's stages.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from piezo_rig.run_file import Sweep

RATE = 2000.0
CONDITIONS = (("0-30", 0.0, 30.0), ("0-50", 0.0, 50.0), ("0-75", 0.0, 75.0), ("75-25", 25.0, 75.0))


def drive_of(low, high, cycles=3, hz=2.0, rate=RATE):
    half = round(rate / hz / 2)
    up = np.linspace(low, high, half + 1)
    if low == 0:
        return np.append(np.tile(np.concatenate([up[:-1], up[:0:-1]]), cycles), low)
    ramp = np.linspace(0.0, high, round(high / 300.0 * rate) + 1)
    loops = np.tile(np.concatenate([up[:0:-1], up[:-1]]), cycles)
    return np.concatenate([ramp[:-1], loops, ramp[::-1]])


def actuator(seed=0):
    """A function drive -> displacement with the virgin memory of a random Prandtl body."""
    rng = np.random.default_rng(seed)
    thresholds = np.sort(rng.uniform(0.2, 36.0, 60))
    weights = rng.uniform(0.5, 1.5, 60) * 1.1e-3

    def play(drive):
        states = np.zeros(thresholds.size) + drive[0]
        out = np.empty(drive.size)
        for i, v in enumerate(drive):
            states = np.minimum(np.maximum(states, v - thresholds), v + thresholds)
            out[i] = 0.09 * v + weights @ states
        return out

    return play


def relaxation(x, tau, rate=RATE):
    """Towards the mean of every two samples, from zero at first."""
    decay = np.exp(-1.0 / rate / tau)
    mean = 0.5 * (x[1:] + x[:-1])
    return np.append(0.0, lfilter([1.0 - decay], [1.0, -decay], mean))


def noise(kind, n, rng):
    if kind == "ar":
        e = rng.standard_normal(n) * 5e-3 * np.sqrt(1 - 0.95**2)
        out = np.empty(n)
        x = 5e-3 * rng.standard_normal()
        for i in range(n):
            x = 0.95 * x + e[i]
            out[i] = x
        return out
    if kind == "1/f":
        size = 1 << int(np.ceil(np.log2(8 * n)))
        f = np.maximum(np.arange(size // 2 + 1), 1) / size
        x = np.fft.irfft(np.fft.rfft(rng.standard_normal(size)) / np.sqrt(f), size)[:n]
        return 3e-3 * x / x.std() + 1e-3 * rng.standard_normal(n)
    return 2e-3 * rng.standard_normal(n)


_known = {}


def recordings(
    effect=None, repeats=2, kind="white", seed=0, conditions=CONDITIONS, sensor=None, before=None
):
    """Sweeps of every condition; ``before(drive)``, ``effect(x, drive, t)``, ``sensor(x, t)``."""
    rng = np.random.default_rng(seed + 100)
    play = actuator(seed)
    out, clock = [], 10.0
    for repeat in range(1, repeats + 1):
        for name, low, high, *hz in conditions:
            drive = drive_of(low, high, hz=hz[0] if hz else 2.0)
            key = (seed, low, high, drive.size, before)
            if key not in _known:
                _known[key] = play(drive if before is None else before(drive))
            x = _known[key]
            t = np.arange(drive.size) / RATE
            if effect is not None:
                x = effect(x, drive, t)
            if sensor is not None:
                x = sensor(x, t + clock, rng)
            x = x + noise(kind, x.size, rng)
            out.append(Sweep(
                name=f"sweep_{len(out) + 1:04d}", command_v=(drive - 75.0) / 7.5,
                sensor_v=-x / 15.48, sample_rate=RATE, gain=7.5, offset_v=75.0,
                sensitivity_um_per_v=15.48, polarity=-1, zero_v=-x[0] / 15.48, condition=name,
                repeat=repeat, history="virgin", start_time=clock, origin="IMPORTED",
            ))
            clock += drive.size / RATE + 31.237
    return out
