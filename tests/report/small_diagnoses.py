"""Diagnoses of a small bench that take a second or two: 500 samples per second, two conditions."""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "diagnosis"))
from small_bench import actuator, drive_of, relaxation

from piezo_rig.diagnosis import diagnose
from piezo_rig.run_file import Sweep

RATE = 500.0


def sweeps(
    effect=True, repeats=2, names=("0-50", "0-75"), history="virgin", spikes=False, late=False
):
    """Creep of five relaxations in 2 nm of noise, seen late by 0.4 ms if asked for."""
    rng, play, out = np.random.default_rng(7), actuator(0), []
    for repeat in range(1, repeats + 1):
        for name, upper in zip(names, (50.0, 75.0), strict=False):
            drive = drive_of(0.0, upper, cycles=3, rate=RATE)
            x = play(drive)
            if effect:
                x = x + 0.005 * sum(relaxation(x, tau, RATE) for tau in (0.03, 0.1, 0.3, 1.0, 3.0))
            if late:
                x = np.interp(np.arange(x.size) - 4e-4 * RATE, np.arange(x.size), x)
            x = x + 2e-3 * rng.standard_normal(x.size)
            if spikes:
                x[rng.integers(10, x.size - 10, 3)] += 1.0
            out.append(Sweep(
                name=f"sweep_{len(out) + 1:04d}", command_v=(drive - 75.0) / 7.5, sensor_v=x,
                sample_rate=RATE, gain=7.5, offset_v=75.0, sensitivity_um_per_v=1.0, polarity=1,
                zero_v=x[0], condition=name, repeat=repeat, history=history,
                start_time=60.0 * len(out), origin="IMPORTED", source=name,
            ))  # fmt: skip
    return out


HOSTILE = '</script><img src=x onerror="alert(1)">'


@cache
def diagnosis(kind):
    """``many`` causes with hostile names, ``two`` of the model, ``quiet``, ``alone`` (no repeats),
    ``fixed`` baseline.
    """
    if kind == "many":
        return diagnose(sweeps(spikes=True, names=(HOSTILE, "a&b'<i>")))
    if kind == "two":
        return diagnose(sweeps(late=True))
    if kind == "fixed":
        return diagnose(sweeps(effect=False, names=("0-75",)), baseline=diagnosis("quiet").model)
    return diagnose(sweeps(effect=False, names=("0-75",), repeats=2 if kind == "quiet" else 1))
