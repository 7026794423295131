"""Ctrl-C, SIGTERM and a closed terminal: noted where they strike, obeyed between two steps."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

from piezo_rig.errors import Aborted


class Stop:
    """Remembers that somebody wants the run to end; the runner looks between its steps.

    A signal never raises where it strikes: it could strike inside a driver or the HDF5 library.
    A burst that plays is waited for in any case, because it ends at rest. A second signal
    changes nothing, because nothing is faster.
    """

    def __init__(self) -> None:
        self.signal = ""
        self.doing = ""  # what is finished first, for the message

    def catch(self, number: int, frame: FrameType | None) -> None:
        """Signal handler."""
        name = signal.Signals(number).name
        first = f"{self.doing} is played to its end first, " if self.doing else ""
        if self.signal:
            say(f"\n{name}: already stopping; {first}then the stack rests, nothing is faster\n")
            return
        self.signal = name
        say(f"\nstopping on {name}: {first}then the stack rests\n")

    def check(self) -> None:
        """Raise Aborted if a signal has come."""
        if self.signal:
            raise Aborted(
                "aborted", f"stopped by {self.signal}", "the operator or the system",
                "go on with 'piezo-rig run --resume'",
            )

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Signals are noted until this is left."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        numbers = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
        before = [signal.signal(n, self.catch) for n in numbers]
        try:
            yield
        finally:
            for number, handler in zip(numbers, before, strict=True):
                signal.signal(number, handler)


def say(text: str) -> None:
    """Past Python's buffers, which a handler must not touch; the terminal may be gone."""
    with suppress(OSError):
        os.write(2 if os.isatty(2) else 1, text.encode())
