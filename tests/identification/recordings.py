"""Recordings made by the slow, independent actuators of the chain's tests."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from piezo_rig.run_file import Sweep

sys.path.insert(0, str(Path(__file__).parents[1] / "chain"))
from reference_actuators import Branching, Sliders
from small_models import DX, FIRST, K, ride

TOP = 11.7  # volts at which the first rise of K has travelled 7 x DX: DX x sum of its slopes
FIRST_TOP = 13.2  # the same for FIRST
SENSITIVITY = 3.87


def sweep(drive, displacement, condition="0-10", repeat=1, history="virgin", index=1):
    """A sweep as the importer would hand it over: raw volts, polarity -1."""
    return Sweep(
        name=f"sweep_{index:04d}",
        command_v=(np.asarray(drive) - 75.0) / 7.5,
        sensor_v=-np.asarray(displacement) / SENSITIVITY,
        sample_rate=5000.0,
        gain=7.5,
        offset_v=75.0,
        sensitivity_um_per_v=SENSITIVITY,
        polarity=-1,
        zero_v=0.0,
        condition=condition,
        repeat=repeat,
        history=history,
        start_time=0.0,
        origin="IMPORTED",
    )


def classical(turns, points=100, springs=K, slides=None):
    """Drive and displacement of springs and sliders."""
    drive = ride([float(v) for v in turns], points)
    slides = DX * np.arange(1.0, len(springs) + 1) if slides is None else slides
    return drive, np.array(Sliders(springs, slides).play(list(drive)))


def lawful(turns, law, points=100):
    """Drive and displacement of branches that follow a law."""
    turns = [float(v) for v in turns]
    return ride(turns, points), np.array(Branching(DX, FIRST, K, law).play(turns, points))


def matrix(play, spans=(5.0, 7.0, 9.0, TOP), cycles=4, top=TOP, noise=0.0, repeats=1):
    """Conditions 0-span and top-(top-span), as the thesis played them."""
    rng = np.random.default_rng(3)
    out = []
    for repeat in range(1, repeats + 1):
        for span in spans:
            rises = [("0", [0.0] + [span, 0.0] * cycles)]
            if span < top:
                rises.append(("top", [0.0, *([top, top - span] * cycles), top, 0.0]))
            for side, turns in rises:
                drive, y = play(turns)
                y = y + noise * rng.standard_normal(y.size)
                out.append(sweep(drive, y, f"{side}-{span:g}", repeat, index=len(out) + 1))
    return out
