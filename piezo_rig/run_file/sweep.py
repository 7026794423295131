"""One sweep as everything after the bench sees it: raw volts and what turns them into physics.

Raw volts are the truth. Drive and displacement are computed from them here,
and nowhere else.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

HISTORIES = ("virgin", "carried", "unknown")
ORIGINS = ("REAL", "SIMULATED", "IMPORTED")


@dataclass(frozen=True, eq=False)
class Sweep:
    """One uninterrupted recording of one condition.

    Attributes
    ----------
    name : ``sweep_0001`` in a run; recordings given together count on
    command_v : shape (n,), volts of the waveform DAC (NaN where not recorded)
    sensor_v : shape (n,), volts of the sensor's analog output
    sample_rate : samples per second
    gain, offset_v : drive = gain * command + offset_v
    sensitivity_um_per_v, polarity, zero_v :
        displacement = polarity * (sensor_v - zero_v) * sensitivity_um_per_v
    condition : its name, unique in a protocol, as in ``0-65``
    repeat : 1-based
    history : ``virgin``, ``carried`` or ``unknown``
    start_time : seconds since the Unix epoch (UTC); for simulated benches, of the bench's clock
    origin : ``REAL``, ``SIMULATED`` or ``IMPORTED``
    drive_monitor_v : shape (n,) volts measured on the stack, where wired
    sample_times_s : shape (n,), only for recordings whose samples are not evenly spaced
    source : the file that it came from, for messages
    details : further attributes of the condition (lower_v, upper_v, frequency_hz ...)
    resumed_after_s : pause since the sweep before, where a run was resumed; None elsewhere
    superseded_by : name of the sweep that was played in its stead; empty if none was
    """

    name: str
    command_v: FloatArray
    sensor_v: FloatArray
    sample_rate: float
    gain: float
    offset_v: float
    sensitivity_um_per_v: float
    polarity: int
    zero_v: float
    condition: str
    repeat: int
    history: str
    start_time: float
    origin: str
    drive_monitor_v: FloatArray | None = None
    sample_times_s: FloatArray | None = None
    source: str = ""
    details: dict[str, float | str | int | bool] = field(default_factory=dict)
    resumed_after_s: float | None = None
    superseded_by: str = ""

    @property
    def samples(self) -> int:
        return int(self.command_v.size)

    @property
    def time_s(self) -> FloatArray:
        """Seconds since the first sample, shape (n,)."""
        if self.sample_times_s is not None:
            return self.sample_times_s - self.sample_times_s[0]
        return np.arange(self.samples) / self.sample_rate

    @property
    def drive_v(self) -> FloatArray:
        """Volts on the actuator as commanded, shape (n,)."""
        return self.gain * self.command_v + self.offset_v

    @property
    def displacement_um(self) -> FloatArray:
        """Micrometres from the sweep's zero, shape (n,)."""
        return self.polarity * (self.sensor_v - self.zero_v) * self.sensitivity_um_per_v

    def with_(self, **changes: object) -> Sweep:
        """A copy with some attributes changed."""
        return replace(self, **changes)  # type: ignore[arg-type]
