"""When the digitizer really samples: its time base, its delay, its losses. Units: s."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.simulated.plant.effects import setting, switch


@dataclass(frozen=True)
class TimeSkew:
    """The sensor channel lags: record(t) = displacement(t - delay). The drive's does not."""

    on: bool = switch(False)
    delay: float = setting(1e-4, "s", "of the sensor channel", low=0.0, high=0.1)


@dataclass(frozen=True)
class ClockRatio:
    """Generator and digitizer run on different time bases."""

    on: bool = switch(False)
    ppm: float = setting(20.0, "ppm", "positive: the digitizer's clock is fast", -1e5, 1e5)


@dataclass(frozen=True)
class DroppedSamples:
    """Samples are missing from a record, in every channel; what follows is shifted."""

    on: bool = switch(False)
    drops: tuple[tuple[int, int], ...] = setting(
        (), "samples", "index in the record of the first missing sample, and how many", low=0
    )
    per_second: float = setting(0.0, "1/s", "random single losses beside them", low=0.0)


@dataclass(frozen=True)
class Acquisition:
    """Turns a request for samples into the instants at which they are taken."""

    time_skew: TimeSkew = field(default_factory=TimeSkew)
    clock_ratio: ClockRatio = field(default_factory=ClockRatio)
    dropped_samples: DroppedSamples = field(default_factory=DroppedSamples)

    @property
    def delay(self) -> float:
        return self.time_skew.delay if self.time_skew.on else 0.0

    def ticks(self, tick: int, rate: float, count: int, seed: int) -> NDArray[np.int64] | None:
        """Which samples of the digitizer's clock make the record (count,); None: all in a row.

        ``tick`` numbers the record's first sample from bench time 0.
        """
        effect = self.dropped_samples
        if not effect.on or not (effect.drops or effect.per_second > 0.0):
            return None
        from drivers.simulated.plant import noise

        kept = np.arange(count)
        for index, missing in sorted(effect.drops):
            kept[index:] += missing
        if effect.per_second > 0.0:
            chance = min(0.5, effect.per_second / rate)
            span = int(kept[-1]) + 1 if count else 0
            spare = int(4.0 * chance * span + 64)
            lost = noise.lost(seed, chance, tick, rate, span + spare)
            kept = np.flatnonzero(~lost)[kept]
        return np.asarray(kept, dtype=np.int64)

    def true_rate(self, rate: float) -> float:
        """Samples per bench second when the digitizer believes in ``rate``."""
        return rate * (1.0 + 1e-6 * self.clock_ratio.ppm) if self.clock_ratio.on else rate
