"""Protocol + rig -> Plan."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezo_rig.config import Rig
from piezo_rig.errors import LimitError
from piezo_rig.protocol.checks import check_plan
from piezo_rig.protocol.plan import (
    DAC_FULL_SCALE,
    DAC_MAX_POINTS,
    MIN_SPAN_V,
    REST_DRIVE_V,
    Plan,
    PlannedSweep,
    Wave,
)
from piezo_rig.protocol.protocol_file import Condition, Protocol
from piezo_rig.protocol.waveforms import count, sample, sweep_segments


def build_plan(protocol: Protocol, rig: Rig) -> Plan:
    """The samples of every sweep.

    Raises
    ------
    LimitError : a sweep is longer than the instruments' memory, or outside their range
    """
    waves = [_wave(condition, protocol, rig) for condition in protocol.conditions]
    sweeps: list[PlannedSweep] = []
    for repeat in range(1, protocol.repeats + 1):
        for index in protocol.order_of(repeat):
            history = protocol.history if sweeps else "virgin"
            sweeps.append(
                PlannedSweep(
                    name=f"sweep_{len(sweeps) + 1:04d}",
                    condition=protocol.conditions[index],
                    repeat=repeat, history=history, wave=waves[index],
                )
            )
    plan = Plan(protocol, rig, tuple(sweeps))
    check_plan(plan)
    return plan


def _wave(condition: Condition, protocol: Protocol, rig: Rig) -> Wave:
    rate = protocol.sample_rate
    segments = sweep_segments(condition.segments, REST_DRIVE_V, protocol.approach_slew_v_per_s)
    points = count(segments, rate) + 1
    if points > DAC_MAX_POINTS or points < 9:
        raise LimitError(
            "limit-memory",
            f"{protocol.path}:{condition.line}: condition {condition.name}: {points - 1} samples "
            f"at {rate:g} Sa/s; the waveform DAC holds 8 to {DAC_MAX_POINTS} points",
            "the sweep is too long (or too short) for this sample rate",
            "use fewer cycles, shorter holds, or a lower sample_rate",
        )
    drive = sample(segments, rate, REST_DRIVE_V)
    return quantised(drive, rig)


def quantised(drive_v: NDArray[np.float64], rig: Rig) -> Wave:
    """A sweep's drive as DAC codes and back, each waveform normalised to its own extremes.

    LOW stays at the rest command whatever the waveform, so that the generator's rest level
    never moves; only HIGH differs between waveforms.
    """
    command = (drive_v - rig.offset_v) / rig.gain
    low = rig.rest_command_v
    high = max(float(command.max()), low + MIN_SPAN_V)
    steps = (command - low) * (2 * DAC_FULL_SCALE / (high - low))
    codes = np.full(command.size + 1, -DAC_FULL_SCALE, dtype=np.int16)
    codes[:-1] = np.clip(np.rint(steps), 0, 2 * DAC_FULL_SCALE).astype(np.int32) - DAC_FULL_SCALE
    played = low + (codes[:-1].astype(float) + DAC_FULL_SCALE) * (
        (high - low) / (2 * DAC_FULL_SCALE)
    )
    below = drive_v < REST_DRIVE_V
    if below.any():  # kept as asked, so that the check names the sample instead of hiding it
        played = np.where(below, command, played)
    return Wave(codes, low, high, played, rig.gain * played + rig.offset_v)
