"""The form of a stage sample by sample: what it is, its numbers; no state and no code.

A stage that acts on the signal says with an `Increment` which of a handful of operations it is.
A machine that goes along a drive one sample at a time (`piezo_rig.compensation`) keeps the state
and knows the operations; `Model.simulate` plays the very same stages on whole signals.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class Operation(IntEnum):
    """What a stage does to the signal at its place; the numbers that it takes, in order.

    The first four and `BEND_DRIVE` act on the drive, `WIDEN` on what the sliders see of it,
    `STRETCH` on what they do, the rest on the displacement. An exponent below 0 is none, but
    how many times the reference rate is the one at which a lag levels off, with the other sign.
    """

    GAIN = 0
    """ratio"""
    CLIP = 1
    """lower V, upper V"""
    SLEW = 2
    """V/s"""
    LAG = 3
    """time constant s; above 0"""
    WIDEN = 4
    """width V at the reference rate, exponent, window s, reference rate V/s"""
    BEND = 5
    """from V, over V, coefficients um of the powers 2, 3, 4, 5"""
    DRAG = 6
    """lag um at the reference rate, exponent, window s, reference rate V/s, if it settles (1)"""
    RELAX = 7
    """how many; their time constants s; their weights"""
    MODE = 8
    """share, angular frequency 1/s, damping, how late it is on a ramp in s"""
    AGE = 9
    """share of the stroke per decade of cycles"""
    STOP = 10
    """share of the compliance at its ends, whether the share fades (1), where it begins, of the
    width; how many, their widths um"""
    BEND_DISPLACEMENT = 11
    """coefficients 1/um and 1/um^2 of its square and cube"""
    BEND_DRIVE = 12
    """from V, over V, coefficients V of u (u - 1) and u^2 (u - 1)"""
    GIVE_BACK = 13
    """share of the compliance right after a turning point, reach um"""
    STRETCH = 14
    """share at the reference rate, exponent, window s, reference rate V/s; how many sliders, their
    thresholds V, by how much each opens the branch, um/V"""


@dataclass(frozen=True)
class Increment:
    """One operation and its numbers."""

    operation: Operation
    numbers: tuple[float, ...]
