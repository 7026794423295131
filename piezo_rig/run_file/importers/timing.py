"""From recorded times to a sample rate, or to times that are kept because no rate fits.

Recorded times are usually even times that were printed with few decimals; such a rate
is recovered exactly. Times that run backwards or stand still are an error: what was
measured when would have to be guessed.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from piezo_rig.errors import InputError
from piezo_rig.run_file.sweep import FloatArray

EVEN_WITHIN = 0.02
"""Sampling is even when no sample is further from its place than this part of a step."""

_SLOW_HZ, _LONG_S = 5.0, 600.0
"""A stack is hardly ever watched with fewer samples a second than this, for longer than that."""

_GAP_STEPS = 1.5
_NAMED_GAPS = 3


@dataclass
class Timing:
    """How the samples of a sweep lie in time.

    Attributes
    ----------
    sample_rate : samples per second; of uneven samples, from their median step
    sample_times_s : seconds since the first sample where sampling is uneven, else None
    notes, warnings : sentences
    """

    sample_rate: float
    sample_times_s: FloatArray | None = None
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def first_backward_step(times: FloatArray) -> int | None:
    """Index of the first sample that is not later than the one before it."""
    wrong = np.flatnonzero(~(times[1:] > times[:-1]))
    return int(wrong[0]) + 1 if wrong.size else None


def timing_of(times: FloatArray, declared_step_s: float | None, place: str) -> Timing:
    """The sample rate behind recorded times that grow.

    Parameters
    ----------
    times : shape (n,), seconds, n >= 2, growing
    declared_step_s : spacing that the file's header gives, tried first
    place : the file, for messages

    Raises
    ------
    InputError : a span or a step that is no sampling at all (absurd steps)
    """
    timing = _timing(times, declared_step_s, place)
    span = float(times[-1] - times[0])
    if timing.sample_rate <= _SLOW_HZ and span >= _LONG_S:
        timing.warnings.append(
            f"{timing.sample_rate:.4g} samples a second over {span:.5g} s, slower than a stack is "
            "usually watched: if its times are milliseconds, divide them by 1000, or everything "
            "that goes by time is wrong"
        )
    return timing


def _timing(times: FloatArray, declared_step_s: float | None, place: str) -> Timing:
    elapsed = times - times[0]
    steps = np.diff(elapsed)
    step = float(np.median(steps))
    span = float(elapsed[-1])
    if not 1e-12 <= step <= 1e9 or span / step > 1e15:
        raise InputError(
            "import-time",
            f"{place}: its times run from {times[0]:.6g} to {times[-1]:.6g} s in steps of "
            f"{step:.3g} s, which is no sampling",
            cause="a damaged time column, or one that is not in seconds",
        )
    index = np.arange(times.size, dtype=np.float64)
    mean_step = span / (times.size - 1)
    grain, rounding = _grain(times, step), 4 * float(np.spacing(np.abs(times).max()))
    error = float(np.abs(elapsed - index * mean_step).max())
    if _even(steps, error, mean_step, rounding) or _even_as_printed(steps, error, grain + rounding):
        allowed = 1.01 * error + 0.51 * grain + rounding
        return Timing(_plain_rate(elapsed, index, mean_step, declared_step_s, allowed))
    timing = Timing(1 / step, elapsed)
    gaps = np.flatnonzero(steps > _GAP_STEPS * step + rounding)
    if 0 < gaps.size <= max(_NAMED_GAPS, 0.01 * steps.size):
        for gap in gaps[:_NAMED_GAPS]:
            timing.warnings.append(
                f"{steps[gap]:.6g} s pass between samples {gap} and {gap + 1}, where the step is "
                f"{step:.6g} s: a gap; the samples keep their recorded times"
            )
        if gaps.size > _NAMED_GAPS:
            timing.warnings.append(f"{gaps.size} gaps in all")
    else:
        spread = float(steps.max() - steps.min())
        timing.notes.append(
            f"sampling is uneven (steps of {step:.6g} s, spread {spread:.3g} s), "
            "so every sample keeps its recorded time"
        )
    return timing


def _even(steps: FloatArray, error: float, mean_step: float, rounding: float) -> bool:
    return bool(
        error <= EVEN_WITHIN * mean_step + rounding
        and steps.max() < _GAP_STEPS * mean_step + rounding
    )


def _even_as_printed(steps: FloatArray, error: float, grain: float) -> bool:
    """Whether even times, rounded to a grain, explain what was recorded."""
    return bool(error <= 1.01 * grain and steps.max() - steps.min() <= 1.01 * grain)


def _grain(times: FloatArray, step: float) -> float:
    """The coarsest rounding that the times show, in s; 0 where it is not below the step.

    Times are printed with so many decimals or so many significant digits; counting
    digits from the front serves both.
    """
    sample = np.abs(times[:: max(1, times.size // 2000)])
    sample = sample[sample > 1e-3 * step]
    if not sample.size:
        return 0.0
    leading = np.floor(np.log10(sample) + 1e-12)
    for digits in range(1, 11):
        scaled = sample * 10.0 ** (digits - 1 - leading)
        if np.abs(scaled - np.round(scaled)).max() < 1e-4:
            grain = float(10.0 ** (leading.max() - digits + 1))
            return grain if grain <= 0.6 * step else 0.0
    return 0.0


def _plain_rate(
    elapsed: FloatArray,
    index: FloatArray,
    mean_step: float,
    declared_step_s: float | None,
    allowed: float,
) -> float:
    """The plainest rate that explains the times as well as their mean step does."""
    rates = [float(f"{1 / mean_step:.{digits}g}") for digits in range(1, 13)]
    if declared_step_s:
        rates.insert(0, 1 / declared_step_s)
    for rate in rates:
        if rate > 0 and np.abs(elapsed - index / rate).max() <= allowed:
            return rate
    return 1 / mean_step
