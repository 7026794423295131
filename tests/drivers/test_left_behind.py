"""What a guard finds when a program was killed, and how it ramps on a line that is slow."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.waveform_dac import LATE_STEP_V, STEP_V, Keysight33500B

SLEW = 30.0  # command volts per second
MESSAGE_S = 3e-3


@pytest.fixture
def dac(bench, line):
    driver = Keysight33500B(line(bench.addresses["waveform_dac"]))
    driver.connect()
    return driver


class SlowLine(VirtualClock):
    """The bench's clock, on which every look after a message finds that time has passed."""

    def __init__(self, bench: VirtualClock) -> None:
        super().__init__()
        self._bench = bench

    def now(self) -> float:
        return self._bench.sleep(MESSAGE_S)

    def sleep(self, seconds: float) -> float:
        return self._bench.sleep(seconds)


def test_a_memory_that_was_cleared_with_nothing_selected_is_still_rest(
    dac, client, plant, clock, line, bench
):
    dac.go_to_rest(-10.0, slew_v_per_s=SLEW, clock=clock)
    client("waveform_dac").ask("SOUR1:DATA:VOL:CLE;:SYST:ERR?")  # where load() was killed
    before = len(plant.events)
    guard = Keysight33500B(line(bench.addresses["waveform_dac"]))
    guard.connect()
    assert guard.output_level() == pytest.approx(-10.0, abs=1e-3)
    moved = guard.go_to_rest(-10.0, slew_v_per_s=SLEW, clock=clock)
    assert moved["to_v"] == pytest.approx(-10.0, abs=1e-3)
    assert np.abs(np.array(plant.levels[before:]) + 10.0).max() <= 0.0101
    assert plant.stack_v(clock.now()) == pytest.approx(0.0, abs=1e-6)


def test_a_guard_makes_up_for_a_slow_line_and_keeps_the_slew_limit(dac, plant, clock):
    before = len(plant.levels)
    moved = dac.go_to_rest(
        -10.0, slew_v_per_s=SLEW, clock=SlowLine(clock), largest_step_v=LATE_STEP_V
    )
    assert moved["to_v"] == pytest.approx(-10.0, abs=1e-3)
    # pauses of LATE_STEP_V / SLEW and messages of MESSAGE_S; steps of STEP_V would take 1.8 s
    expected_s = 10.0 / LATE_STEP_V * (LATE_STEP_V / SLEW + MESSAGE_S)
    assert moved["duration_s"] == pytest.approx(expected_s, rel=0.05)
    times = np.array([t for t, _, _ in plant.events])[before:]
    levels = np.array(plant.levels[before:])
    steps = np.abs(np.diff(levels))
    assert steps.max() <= LATE_STEP_V + 1e-9
    ramp = steps > STEP_V  # of the rest, some are settings that are made twice
    assert ramp.sum() > 90
    assert np.all(steps[ramp] <= SLEW * (np.diff(times)[ramp] - MESSAGE_S) + 1e-9)


def test_a_guard_on_a_quick_line_moves_in_ordinary_steps(dac, plant, clock):
    before = len(plant.levels)
    dac.go_to_rest(-10.0, slew_v_per_s=SLEW, clock=clock, largest_step_v=LATE_STEP_V)
    assert np.abs(np.diff([0.0, *plant.levels[before:]])).max() <= STEP_V + 1e-9
