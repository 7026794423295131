"""One injected clock. Nothing in this program sleeps but through it."""

from __future__ import annotations

import threading
import time
from typing import Protocol


class Clock(Protocol):
    """Seconds that only grow, and a way to let them pass."""

    def now(self) -> float: ...

    def sleep(self, seconds: float) -> float:
        """Let time pass; what ``now`` says afterwards."""
        ...


class RealClock:
    """The machine's monotonic clock; it says ``start`` at its creation."""

    def __init__(self, start: float = 0.0) -> None:
        self._start = time.monotonic() - start

    def now(self) -> float:
        return time.monotonic() - self._start

    def sleep(self, seconds: float) -> float:
        time.sleep(max(0.0, seconds))
        return self.now()


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

    def sleep(self, seconds: float) -> float:
        with self._lock:
            self._ahead += max(0.0, seconds)
            return self._now()

    def advance_to(self, instant: float) -> None:
        """Jump forward to ``instant``; never back."""
        with self._lock:
            self._ahead += max(0.0, instant - self._now())


class BenchClock:
    """The clock of a simulated bench in another process, asked over its clock port.

    ``address`` is a ``TCPIP::host::port::SOCKET`` as `piezo-rig bench` prints it.
    """

    def __init__(self, address: str, timeout_s: float = 10.0) -> None:
        from drivers.scpi_instrument import ScpiInstrument
        from drivers.transport import open_transport

        self._link = ScpiInstrument(open_transport(address, "bench clock", timeout_s))
        self._link.connect(("bench clock",))

    def now(self) -> float:
        return float(self._link.query("CLOCK:TIME?"))

    def sleep(self, seconds: float) -> float:
        if seconds <= 0:
            return self.now()
        usual = self._link.transport.timeout_s
        # On a real clock the answer takes as long as the sleep.
        message = f"CLOCK:SLEEP {seconds:.9g};:CLOCK:TIME?"
        return float(self._link.query(message, timeout_s=seconds + usual))

    def close(self) -> None:
        self._link.close()
