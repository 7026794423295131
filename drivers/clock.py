"""One injected clock. Nothing in this program sleeps but through it."""

from __future__ import annotations

import threading
import time
from typing import Protocol


class Clock(Protocol):
    """Seconds that only grow, and a way to let them pass."""

    def now(self) -> float: ...

    def sleep(self, seconds: float) -> None: ...


class RealClock:
    """The machine's monotonic clock, counted from the clock's creation."""

    def __init__(self) -> None:
        self._start = time.monotonic()

    def now(self) -> float:
        return time.monotonic() - self._start

    def sleep(self, seconds: float) -> None:
        time.sleep(max(0.0, seconds))


class VirtualClock:
    """A clock that jumps: sleeping costs nothing, so a 60 s timeout is tested in microseconds.

    With ``follow_wall`` it never falls behind the wall clock, which is what a
    stand-alone simulated bench needs: a client that polls without ever waiting
    still sees time pass.
    """

    def __init__(self, start: float = 0.0, follow_wall: bool = False) -> None:
        self._lock = threading.Lock()
        self._ahead = start
        self._wall = time.monotonic() if follow_wall else None

    def now(self) -> float:
        with self._lock:
            return self._now()

    def _now(self) -> float:
        if self._wall is None:
            return self._ahead
        return self._ahead + (time.monotonic() - self._wall)

    def sleep(self, seconds: float) -> None:
        with self._lock:
            self._ahead += max(0.0, seconds)

    def advance_to(self, instant: float) -> None:
        """Jump forward to ``instant``; never back."""
        with self._lock:
            self._ahead += max(0.0, instant - self._now())
