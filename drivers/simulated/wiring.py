"""The cables between the simulated instruments, and the one plant behind them.

The generator's output goes to the amplifier, its trigger output to the
digitizer's external trigger, amplifier and interferometer to the digitizer's
inputs. The plant is lazy: it is told what happens and asked what it measured,
in the order of bench time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.clock import Clock

_SAME_INSTANT_S = 1e-9  # a clock that jumps to an instant may miss it by a rounding


class Record(Protocol):
    """Analog volts at the digitizer's inputs, one value per sample."""

    @property
    def stack_v(self) -> NDArray[np.float64]: ...

    @property
    def sensor_v(self) -> NDArray[np.float64]: ...


class Plant(Protocol):
    """Amplifier, actuator and sensor. Times are bench seconds and never decrease."""

    def set_level(self, t: float, command_v: float) -> None: ...

    def play(
        self, t: float, command_v: NDArray[np.float64], rate: float, holds_last: bool = False
    ) -> None: ...

    def set_amplifier_offset(self, t: float, volts: float) -> None: ...

    def record(self, t: float, rate: float, count: int) -> Any: ...


class Capture:
    """One record that the digitizer has been triggered for."""

    def __init__(self, begin: float, rate: float, count: int) -> None:
        self.begin = begin
        self.rate = rate
        self.count = count
        self.record: Record | None = None

    @property
    def end(self) -> float:
        return self.begin + self.count / self.rate


class Wiring:
    """Passes levels, waveforms and trigger pulses on, in the order of time.

    A finished capture is taken from the plant before anything later happens to
    it, so that the plant never has to look back.
    """

    def __init__(self, plant: Plant, clock: Clock) -> None:
        self.plant = plant
        self.clock = clock
        self._captures: list[Capture] = []
        self._latest = 0.0
        self._on_pulse: list[Callable[[float, bool], None]] = []

    def now(self) -> float:
        """Bench time, never before anything the plant has already been asked about."""
        self._latest = max(self._latest, self.clock.now())
        self.finish_captures()
        return self._latest

    def set_level(self, t: float, command_v: float) -> None:
        self.plant.set_level(t, command_v)

    def play(
        self, t: float, command_v: NDArray[np.float64], rate: float, holds_last: bool = False
    ) -> None:
        self.plant.play(t, command_v, rate, holds_last)

    def set_amplifier_offset(self, volts: float) -> None:
        self.plant.set_amplifier_offset(self.now(), volts)

    # ----------------------------------------------------------------- triggers

    def connect_trigger(self, receiver: Callable[[float, bool], None]) -> None:
        """``receiver(t, rising)`` hears every pulse of the trigger output."""
        self._on_pulse.append(receiver)

    def pulse(self, t: float, rising: bool) -> None:
        for receiver in self._on_pulse:
            receiver(t, rising)

    # ----------------------------------------------------------------- captures

    def capture(self, begin: float, rate: float, count: int) -> Capture:
        """Begin a record at ``begin``; it is there once its end has passed."""
        capture = Capture(begin, rate, count)
        self._captures.append(capture)
        return capture

    def drop(self, capture: Capture) -> None:
        if capture in self._captures:
            self._captures.remove(capture)

    def finish_captures(self) -> None:
        """Take every record whose end has passed."""
        instant = max(self._latest, self.clock.now()) + _SAME_INSTANT_S
        for capture in [c for c in self._captures if c.end <= instant]:
            capture.record = self.plant.record(capture.begin, capture.rate, capture.count)
            self._captures.remove(capture)
            self._latest = max(self._latest, capture.end)
