"""Work that a forked process does while this one does other things.

A fork knows all that its parent knows, so only what it found has to be handed over.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable
from typing import BinaryIO, NoReturn


def worth_it() -> bool:
    """Whether there is a second processor for this process alone, and forking it is safe."""
    return (
        sys.platform.startswith("linux")
        and len(os.sched_getaffinity(0)) > 1
        and multiprocessing.parent_process() is None
        and threading.active_count() == 1
    )


class Forked:
    """A process that writes what it found and ends, whatever becomes of it.

    Within ``with`` it works; on the way out it is gone, killed if that is by an error.

    Raises
    ------
    OSError : no room for another process
    """

    def __init__(self, work: Callable[[BinaryIO], None]) -> None:
        self._read, write = os.pipe()
        pid = -1
        with warnings.catch_warnings():
            # some Python versions warn of threads; those of linear algebra are made anew
            warnings.simplefilter("ignore", DeprecationWarning)
            try:
                pid = os.fork()
            finally:
                if pid < 0:
                    os.close(self._read)
                    os.close(write)
        if pid == 0:
            os.close(self._read)
            _work(work, write)
        os.close(write)
        self._pid = pid

    def __enter__(self) -> Forked:
        return self

    def __exit__(self, error: object, *_: object) -> None:
        if error is not None:
            os.kill(self._pid, signal.SIGKILL)
        os.close(self._read)
        os.waitpid(self._pid, 0)

    def found(self) -> bytes:
        """All that it wrote, once it ends; nothing or a part of it if it failed."""
        with os.fdopen(os.dup(self._read), "rb") as file:
            return file.read()


def _work(work: Callable[[BinaryIO], None], write: int) -> NoReturn:
    try:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # the parent speaks for both
        with os.fdopen(write, "wb") as out:
            work(out)
    finally:
        os._exit(0)  # the parent does what it does not hear of
