"""The runner's side of the guard: starts it, shows signs of life, says when it is over."""

from __future__ import annotations

import contextlib
import math
import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

from drivers.errors import InstrumentError
from drivers.transport import Observer, Transport
from piezo_rig.guard.lock import Tell, hold
from piezo_rig.guard.orders import BEAT_S, Orders
from piezo_rig.guard.relay import RelayTransport

SLACK_S = 60.0
"""A step may take this much longer than expected before the runner counts as hanging."""
_END_S = 10.0


class Unguarded:
    """A bench that lives in the runner's own process, or has ended with it, needs no guard."""

    def arm(self, serial: str) -> None: ...

    def step(self, name: str, expected_s: float = 0.0) -> None: ...

    def check(self) -> None: ...

    def end(self, at_rest: bool) -> None: ...


class Keeper(Unguarded):
    """A guard process and what it hears from the runner.

    A thread shows a sign of life every `BEAT_S`, but only while the step that
    the runner is in takes no longer than it may: a runner that stands still,
    as a whole or in one step, falls silent.

    Raises
    ------
    InstrumentError : bench-busy, guard-lost
    """

    def __init__(self, orders: Orders, tell: Tell = lambda text: None) -> None:
        self.orders = orders
        self._lock = hold(orders.address, tell)
        self._line, theirs = socket.socketpair()
        listen, self._beats = os.pipe()
        os.set_blocking(self._beats, False)
        handed = [theirs.fileno(), listen] + ([self._lock] if self._lock >= 0 else [])
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "piezo_rig.guard", str(theirs.fileno()), str(listen),
                 orders.to_json()],
                pass_fds=handed, start_new_session=True, stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL, env=_environment(),
                # A pipe would be held open after the runner's death; a terminal is told.
                stderr=None if os.isatty(2) else subprocess.DEVNULL,
            )
        except OSError as error:
            raise InstrumentError(
                "guard-lost", "waveform_dac", f"the guard process cannot be started: {error}",
                "the computer is out of memory or processes", "mend that, then run again",
            ) from None
        finally:
            theirs.close()
            os.close(listen)
        self._over = threading.Event()
        self._lost = False
        self._may_last_until = math.inf  # until the first step the operator may think
        self._relay: RelayTransport | None = None
        self._thread = threading.Thread(target=self._beat, name="signs of life", daemon=True)
        self._thread.start()

    def transport(self, observer: Observer | None) -> Transport:
        """The generator's line, opened by the guard; InstrumentError as of any line."""
        self._relay = RelayTransport(
            self._line, self.orders.address, "waveform_dac", self.orders.timeout_s, observer,
            self._lose,
        )
        return self._relay

    @property
    def pid(self) -> int:
        """Of the guard process."""
        return self._process.pid

    def arm(self, serial: str) -> None:
        """From now on the guard acts; ``serial`` is the generator's, and no other is moved."""
        self._say(f"arm {serial}")

    def step(self, name: str, expected_s: float = 0.0) -> None:
        """The runner begins something that should take ``expected_s`` at most."""
        self._may_last_until = time.monotonic() + expected_s + SLACK_S
        self._say(f"step {name}")

    def check(self) -> None:
        """InstrumentError guard-lost when the guard is gone."""
        if self._lost or self._process.poll() is not None:
            assert self._relay is not None
            self._relay.reopen()  # says what became of it

    def end(self, at_rest: bool) -> None:
        """Let the guard go, if the stack is at rest or was never moved; else leave it to it."""
        self._over.set()
        self._thread.join()
        heard = at_rest and self._relay is not None and self._relay.finish()
        self._line.close()
        with contextlib.suppress(OSError):
            os.close(self._beats)
        if heard or at_rest:
            try:
                self._process.wait(_END_S)
            except subprocess.TimeoutExpired:
                self._lose()
        else:
            self._process.returncode = 0  # it goes on; nobody waits for it
        if self._lock >= 0:
            os.close(self._lock)

    def _lose(self) -> None:
        self._lost = True
        with contextlib.suppress(OSError):
            self._process.kill()  # its hold on the line ends with it
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_END_S)

    def _say(self, text: str) -> None:
        try:
            os.write(self._beats, text.encode() + b"\n")
        except BlockingIOError:
            pass  # the guard is busy with a long burst and has plenty to read already
        except OSError:
            self._lost = True

    def _beat(self) -> None:
        while not self._over.wait(BEAT_S) and not self._lost:
            if time.monotonic() < self._may_last_until:
                self._say("")


def _environment() -> dict[str, str]:
    """The guard finds the package where this process found it."""
    here = str(Path(__file__).resolve().parent.parent.parent)
    before = os.environ.get("PYTHONPATH")
    return {**os.environ, "PYTHONPATH": here + (os.pathsep + before if before else "")}
