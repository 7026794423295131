"""A few processes on this computer, each with one item at a time.

A process that dies or stands still takes one item with it, and a new one takes its place; that is
why this is not a pool of the standard library, which stops altogether.
"""

from __future__ import annotations

import os
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from multiprocessing import connection, get_context
from typing import Any

from piezo_rig.errors import InputError
from piezo_rig.fleet.item import Item
from piezo_rig.fleet.work import Outcome, failed

DEADLINE_S = 3600.0  # for one item


def on_this_computer(
    work: Callable[[Item], Outcome], items: Sequence[Item], workers: int | None = None,
    deadline_s: float = DEADLINE_S,
) -> Iterator[Outcome]:
    """The outcomes, in the order in which they are ready.

    Parameters
    ----------
    work : of a module, so that another process can import it
    workers : processes; as many as there are processors for this one unless given
    deadline_s : an item that takes longer has failed, and its process is ended
    """
    waiting = deque(items)
    crew = [_Worker(work) for _ in range(min(workers or _processors(), len(items)))]
    try:
        while True:
            for i, worker in enumerate(crew):
                if worker.item is None and waiting:
                    if not worker.alive():
                        crew[i] = worker = _Worker(work)
                    worker.begin(waiting.popleft(), deadline_s)
            busy = [w for w in crew if w.item is not None]
            if not busy:
                return
            until = min(w.until for w in busy)
            connection.wait([w.pipe for w in busy], max(0.0, until - time.monotonic()))
            for worker in busy:
                outcome = worker.outcome(deadline_s)
                if outcome is not None:
                    yield outcome
    finally:
        for worker in crew:
            worker.end()


def _processors() -> int:
    with suppress(AttributeError):  # not on every system
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class _Worker:
    """One process and the pipe to it."""

    def __init__(self, work: Callable[[Item], Outcome]) -> None:
        context = get_context("spawn")  # numba and HDF5 do not survive a fork
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, work), daemon=True)
        self.process.start()
        theirs.close()
        self.item: Item | None = None
        self.until = 0.0

    def alive(self) -> bool:
        return not self.pipe.closed and self.process.is_alive()

    def begin(self, item: Item, deadline_s: float) -> None:
        self.item, self.until = item, time.monotonic() + deadline_s
        with suppress(OSError):  # it has died: said when its outcome is asked for
            self.pipe.send(item)

    def outcome(self, deadline_s: float) -> Outcome | None:
        """What became of the item; None while it is being worked on."""
        assert self.item is not None
        late = time.monotonic() >= self.until
        try:
            if self.pipe.poll():
                found: Outcome = self.pipe.recv()
            elif late:
                found = failed(self.item, InputError(
                    "timeout", f"{self.item.given}: not done after {deadline_s:g} s",
                    "far more data than usual, or a disk that does not answer",
                    "analyse this file by itself",
                ))  # fmt: skip
                self.end()
            else:
                return None
        except (EOFError, OSError):
            self.process.join()
            found = failed(self.item, InputError(
                "worker-died", f"{self.item.given}: the process that worked on it ended "
                f"({_how(self.process.exitcode)})",
                "too little memory, or a file that a library does not survive",
                "analyse this file by itself; see 'piezo-rig verify'",
            ))  # fmt: skip
            self.end()
        self.item = None
        return found

    def end(self) -> None:
        self.pipe.close()
        self.process.kill()
        self.process.join()


def _how(status: int | None) -> str:
    if status is not None and status < 0:
        with suppress(ValueError):
            return signal.Signals(-status).name
    return f"exit status {status}"


def _serve(pipe: Any, work: Callable[[Item], Outcome]) -> None:
    """What a process does: items in, outcomes out, until nobody is there any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever started it ends it
    with suppress(EOFError, OSError):
        while True:
            pipe.send(work(pipe.recv()))
