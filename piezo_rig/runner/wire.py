"""Carries bytes from the transports into the run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from piezo_rig.run_file.writer import RunWriter


@dataclass
class Wire:
    """Carries bytes from the transports to the run; keeps those that come before it exists."""

    writer: RunWriter | None = None
    clock_now: Callable[[], float] = lambda: 0.0
    _early: list[tuple[float, str, str, bytes]] = field(default_factory=list)

    def __call__(self, instrument: str, direction: str, data: bytes) -> None:
        record = (self.clock_now(), instrument, direction, bytes(data))
        if self.writer is None:
            self._early.append(record)
        else:
            self.writer.wire(*record)

    def attach(self, writer: RunWriter) -> None:
        self.writer = writer
        for record in self._early:
            writer.wire(*record)
        self._early.clear()
