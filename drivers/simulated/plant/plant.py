"""One amplifier, actuator and interferometer behind the simulated instruments.

The plant is physics, not the thesis's model. It is lazy: events are noted, and
the motion is computed when somebody asks for it. Every answer is a function of
config, seed and events, however it is asked for.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from drivers.simulated.plant.config import PlantConfig
from drivers.simulated.plant.electrical import nominal_to_target
from drivers.simulated.plant.timeline import Timeline

if TYPE_CHECKING:
    from drivers.simulated.plant.history import Sink

Array = NDArray[np.float64]

SPOT_RATE = 5000.0  # the rate that names the noise of a single reading
_BLOCK = 1 << 17


@dataclass(frozen=True)
class Record:
    """Analog volts (n,) at the digitizer's inputs: drive monitor and interferometer."""

    stack_v: Array
    sensor_v: Array


class Plant:
    """Amplifier, stack and interferometer of a simulated bench.

    Times are bench-clock seconds, from 0 on; those of events never decrease. Before
    the first event the generator is off: the amplifier's set voltage, 75 V, has
    stood on the stack for long. All methods may be called from any thread.

    Parameters
    ----------
    config : settings, or a nested mapping of them (see ``PlantConfig``)
    seed : replaces the config's seed

    Raises
    ------
    ValueError : the mapping holds an unknown key or a value that does not fit.
    """

    def __init__(
        self, config: PlantConfig | Mapping[str, Any] | None = None, seed: int | None = None
    ) -> None:
        if config is None:
            config = PlantConfig()
        elif not isinstance(config, PlantConfig):
            config = PlantConfig.from_mapping(config)
        if seed is not None:
            config = replace(config, seed=seed)
        # Compiled code is loaded when a plant is made, not when the package is imported.
        from drivers.simulated.plant.motion import Motion

        self.config = config
        self._lock = threading.RLock()
        self._sensor = config.interferometer()
        self._acquisition = config.acquisition()
        self._timeline = Timeline(self._target, config.amplifier.offset)
        self._motion = Motion(self.config, self._timeline)
        self._history: Any = None
        self._event_s = 0.0

    def prepare(self) -> None:
        """Compile and load what the physics needs, so that the first answer is not late.

        The first time on a machine this takes some ten seconds, longer than any
        instrument's timeout; afterwards the compiled code is kept.
        """
        trial = Plant(self.config)
        trial.play(0.1, np.array([-10.0, -9.0, -8.0, -9.0, -10.0]), SPOT_RATE)
        trial.record(0.1, SPOT_RATE, 8)

    # ------------------------------------------------------------------- events

    def set_level(self, t: float, command_v: float) -> None:
        """The generator's output is ``command_v`` from t on."""
        with self._lock:
            self._event(t)
            self._timeline.set_level(t, float(command_v))

    def play(
        self, t: float, command_v: NDArray[Any], rate: float, holds_last: bool = False
    ) -> None:
        """The generator puts out sample k from t + k / rate on, then rests at the first.

        ``holds_last``: one that stays at the last instead, as a data acquisition card does.
        """
        command = np.array(command_v, dtype=np.float64)
        if command.ndim != 1 or not command.size or not np.all(np.isfinite(command)):
            raise ValueError("a waveform is a one-dimensional array of finite volts")
        if not rate > 0.0:
            raise ValueError(f"a sample rate is positive, got {rate!r}")
        with self._lock:
            self._event(t)
            self._timeline.play(t, command, float(rate), holds_last)

    def set_amplifier_offset(self, t: float, volts: float) -> None:
        """The amplifier's set voltage, drive at 0 V of command, from t on."""
        with self._lock:
            self._event(t)
            self._timeline.set_offset(t, float(volts))

    def _event(self, t: float) -> None:
        if not t >= self._event_s:
            raise ValueError(f"bench time runs backwards: {t!r} s after {self._event_s!r} s")
        self._event_s = float(t)
        self._motion.go_back(t)
        oldest = self._motion.oldest
        if self._history is not None:
            self._history.write_until(t)
            oldest = min(oldest, self._history.oldest)
        self._timeline.forget_before(oldest)

    def _target(self, command: Array, offset: float) -> Array:
        c = self.config
        return nominal_to_target(command, c.amplifier.gain, offset, c.drive_gain, c.drive_clipping)

    # ------------------------------------------------------------------ answers

    def record(self, t: float, rate: float, count: int) -> Record:
        """Samples at t + k / rate, k = 0 .. count - 1, at any rate.

        Errors of the digitizer (time base, delay, losses) act within one record; ask
        for an acquisition in one piece where losses by index matter.

        Raises
        ------
        ValueError : t lies further back than the plant remembers (15 minutes).
        """
        if not rate > 0.0 or count < 0:
            raise ValueError(f"cannot sample {count!r} times at {rate!r} /s")
        with self._lock:
            stack_v, sensor_v = np.empty(count), np.empty(count)
            tick = round(t * rate)
            kept = self._acquisition.ticks(tick, rate, count, self.config.seed)
            for first in range(0, count, _BLOCK):
                last = min(first + _BLOCK, count)
                k = np.arange(first, last) if kept is None else kept[first:last]
                times = t + k / self._acquisition.true_rate(rate)
                stack_v[first:last], um = self._sample(times)
                sensor_v[first:last] = self._sensor.volts(
                    um, times - self._acquisition.delay, tick + first, rate, self.config.seed
                )
            return Record(stack_v, sensor_v)

    def stack_v(self, t: float) -> float:
        """True volts on the stack at t."""
        with self._lock:
            return float(self._motion.sample(np.array([t]))[0][0])

    def displacement_um(self, t: float) -> float:
        """True displacement of the mirror at t, 0 for the recovered actuator at 0 V."""
        with self._lock:
            return float(self._motion.sample(np.array([t]))[1][0])

    def sensor_v(self, t: float) -> float:
        """Interferometer output at t."""
        return float(self.record(t, SPOT_RATE, 1).sensor_v[0])

    def _sample(self, times: Array) -> tuple[Array, Array]:
        """Drive at the given instants, displacement as late as the sensor channel is."""
        delay = self._acquisition.delay
        if delay == 0.0:
            return self._motion.sample(times)
        both = np.concatenate([times, times - delay])
        order = np.argsort(both, kind="stable")
        volts, um = np.empty(both.size), np.empty(both.size)
        volts[order], um[order] = self._motion.sample(both[order])
        return volts[: times.size], um[times.size :]

    # ------------------------------------------------------------------ history

    def keep_history(self, sink: Sink) -> None:
        """Hand rows (time_s, stack_v) of the stack's own voltage to ``sink`` as they arise.

        Rows up to an instant arise once a later event, or ``flush_history``, fixes
        them. See ``history.csv_sink`` for a file.
        """
        from drivers.simulated.plant.history import History
        from drivers.simulated.plant.motion import Motion

        with self._lock:
            if self._event_s > 0.0 or len(self._timeline.segments) > 1:
                raise ValueError("a history is kept from the first event on")
            motion = Motion(self.config, self._timeline)
            settling = 2e-3 + 20.0 * self.config.amplifier_lag.tau
            if self.config.slew_limit.on:
                settling += 200.0 / self.config.slew_limit.limit
            self._history = History(motion, self._timeline, settling, sink)

    def flush_history(self, t: float) -> None:
        """Write the history up to bench time t, the present."""
        with self._lock:
            if self._history is not None:
                self._history.close(t)

    def stack_history(self) -> Iterator[tuple[float, float]]:
        """The history of all events so far, up to the last one, as (time_s, stack_v).

        Goes back as far as the plant remembers; ``keep_history`` has no such limit.
        """
        from drivers.simulated.plant.history import STEP_S

        with self._lock:
            begin, end = max(0.0, self._motion.oldest), self._event_s
            times = np.arange(begin, end + STEP_S, STEP_S)
            volts, _ = self._motion.sample(times)
        yield from zip(times.tolist(), volts.tolist(), strict=True)
