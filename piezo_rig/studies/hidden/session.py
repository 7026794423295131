"""One sitting at the bench: when everything was recorded, and what the clock did to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_rig.studies.hidden.effects import Effect
from piezo_rig.studies.hidden.events import Event
from piezo_rig.studies.hidden.protocols import Condition

FloatArray = NDArray[np.float64]
REST_S = (55.0, 65.0)  # between recordings


@dataclass(frozen=True, eq=False)
class Session:
    """Effects with their phases, when every recording began, and the seed of events."""

    effects: tuple[Effect, ...]
    starts_s: FloatArray
    events: int

    @classmethod
    def of(
        cls, conditions: tuple[Condition, ...], repeats: int, effects: tuple[Effect, ...],
        rng: np.random.Generator,
    ) -> Session:  # fmt: skip
        seconds = np.array([c.drive_v.size / c.rate for c in conditions] * repeats)
        waits = rng.uniform(*REST_S, seconds.size)
        starts = np.cumsum(waits) + np.append(0.0, np.cumsum(seconds[:-1]))
        events = int(rng.integers(2**31))
        return cls(tuple(e.session(rng) for e in effects), starts, events)

    def added(self, recording: int, condition: Condition, clean_um: FloatArray) -> FloatArray:
        """What is locked to the clock in one recording of a displacement (n,), um."""
        out = np.zeros(condition.drive_v.size)
        clock = self.starts_s[recording] + condition.time_s
        for i, e in enumerate(self.effects):
            more = e.on_clock(clock, self._rng(recording, i))
            if more is not None:
                out = out + more
            own = e.on_recording(recording)
            if own is not None:
                out = out + own
        return self.recorded(recording, clean_um + out) - clean_um

    def recorded(self, recording: int, seen_um: FloatArray) -> FloatArray:
        """What is left in the record (n,) of all that was seen."""
        out = seen_um
        for i, e in enumerate(self.effects):
            kept = e.kept(out.size, self._rng(recording, i))
            if kept is not None:
                out = out[np.minimum(kept, out.size - 1)]
        return out

    def places(self, recording: int, n: int) -> list[tuple[str, int, int]]:
        """Cause, index and count of every event in one recording."""
        return [
            (e.cause, index, count)
            for i, e in enumerate(self.effects) if isinstance(e, Event)
            for index, count in e.instants(n, self._rng(recording, i))
        ]  # fmt: skip

    def _rng(self, recording: int, effect: int) -> np.random.Generator:
        return np.random.default_rng([self.events, recording, effect])
