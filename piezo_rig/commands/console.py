"""What the verbs print: numbers with units, and progress with the time that is left."""

from __future__ import annotations

import sys
import time
from contextlib import suppress
from typing import TextIO


def seconds(value: float) -> str:
    """A duration as people say it."""
    if value < 60:
        return f"{value:.1f} s"
    minutes, rest = divmod(round(value), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s"


def size(value: float) -> str:
    """Bytes as people say them."""
    for unit in ("B", "kB", "MB"):
        if value < 1000:
            return f"{value:.0f} {unit}" if unit == "B" else f"{value:.1f} {unit}"
        value /= 1000
    return f"{value:.1f} GB"


class Progress:
    """One line that says how far it is: rewritten on a terminal's stderr, sparse on stdout else.

    Where stderr is not a terminal it carries errors and nothing else.
    """

    def __init__(self, stream: TextIO | None = None, every_s: float = 5.0) -> None:
        self.stream = stream or (sys.stderr if sys.stderr.isatty() else sys.stdout)
        self.tty = self.stream.isatty()
        self.every_s = 0.1 if self.tty else every_s
        self._last = -1e9
        self._width = 0

    def __call__(self, text: str, force: bool = False) -> None:
        now = time.monotonic()
        if not force and now - self._last < self.every_s:
            return
        self._last = now
        with suppress(OSError):  # a terminal that is gone does not stop a run; its signal does
            if self.tty:
                self.stream.write("\r" + text.ljust(self._width))
                self._width = len(text)
            else:
                self.stream.write(text + "\n")
            self.stream.flush()

    def close(self) -> None:
        """Leave the line as it stands and go on below it."""
        if self.tty and self._width:
            with suppress(OSError):
                self.stream.write("\n")
            self._width = 0
