"""Independent steps of a diagnosis, by two processes at a time.

Most of a diagnosis is many short steps that hold the interpreter's lock, so threads hardly help.
A forked process has all that its parent knows and hands back only what it found. Where there is
one processor, no fork, or this process is itself one of several, the steps are done one after the
other; what comes out is the same, because each begins with the space as it was. Steps may have
steps of their own: whichever process comes to them shares them out if the other has done its part.
"""

from __future__ import annotations

import io
import mmap
import os
import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import Any, BinaryIO, Protocol, TypeVar

from piezo_rig.forked import Forked, worth_it

Made = TypeVar("Made")
Other = TypeVar("Other")


class Settled(Protocol):
    """What steps change as they go, and may have back."""

    def state(self) -> Mapping[str, Any]: ...
    def restore(self, state: Mapping[str, Any]) -> None: ...


class _Working:
    """Which processes have something to do: a byte each, which all of them share.

    The first one's is the first, that of a process that it forks the next, and so on: a process
    has one other at a time, but for those that have done their part.
    """

    DEEPEST = 16
    bytes = mmap.mmap(-1, DEEPEST)
    own = 0

    @classmethod
    def others(cls) -> bool:
        """Whether any other process has."""
        return any(cls.bytes[k] for k in range(cls.DEEPEST) if k != cls.own)

    @classmethod
    def mark(cls, index: int, working: bool) -> None:
        cls.bytes[index] = int(working)


def alone() -> bool:
    """Whether the other processor has nothing to do."""
    return not _Working.others()


def abreast(
    space: Settled, steps: Sequence[Callable[[], Made]], known: Iterable[object] = ()
) -> list[Made]:
    """What each step gives, in order.

    Parameters
    ----------
    space : as it is now for every step, and afterwards
    steps : what they give must be possible to pickle; what else they change may be lost
    known : objects that come back as themselves where they are part of what a step gives

    Raises
    ------
    Exception : of a step that failed
    """
    if len(steps) < 2:
        return [step() for step in steps]
    next_one = _Working.own + 1
    if not alone() or next_one >= _Working.DEEPEST or not worth_it():
        return [_isolated(space, step) for step in steps]
    kept, here = {id(o): o for o in (space, *known)}, os.getpid()
    with _Tickets(len(steps)) as tickets:

        def taken(out: BinaryIO) -> None:
            _Working.own = next_one
            made, answer = dict[int, Any](), io.BytesIO()
            for k in tickets:
                if os.getppid() != here:  # nobody waits for it any more
                    return
                with suppress(Exception):
                    made[k] = _isolated(space, steps[k])
            _Pickler(answer, kept).dump(made)
            _Working.mark(next_one, False)  # what it takes to be heard is no work
            out.write(answer.getbuffer())

        found: dict[int, Any] = {}
        with _marked(next_one):
            try:
                child = Forked(taken)
            except OSError:  # no room for another process
                return [_isolated(space, step) for step in steps]
            with child, _marked(_Working.own):
                for k in tickets:
                    found[k] = _isolated(space, steps[k])
                _Working.mark(_Working.own, False)  # while it waits
                found |= _received(child.found(), kept)
        for k in range(len(steps)):
            if k not in found:  # failed there, as for want of memory, or raises here as well
                found[k] = _isolated(space, steps[k])
    return [found[k] for k in range(len(steps))]


def both(
    space: Settled, one: Callable[[], Made], other: Callable[[], Other],
    known: Iterable[object] = (),
) -> tuple[Made, Other]:  # fmt: skip
    """`abreast` of two steps that give different things."""
    steps: list[Callable[[], Any]] = [one, other]
    made, besides = abreast(space, steps, known)
    return made, besides


@contextmanager
def _marked(index: int) -> Iterator[None]:
    """For as long as that process works, at most; afterwards as it was."""
    before = bool(_Working.bytes[index])
    _Working.mark(index, True)
    try:
        yield
    finally:
        _Working.mark(index, before)


class _Tickets:
    """Numbers of steps that nobody has begun, in a pipe that two processes read from."""

    def __init__(self, count: int) -> None:
        self._read, write = os.pipe()
        os.write(write, b"".join(k.to_bytes(2, "big") for k in range(count)))
        os.close(write)

    def __enter__(self) -> _Tickets:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._read)

    def __iter__(self) -> Iterator[int]:
        while ticket := os.read(self._read, 2):
            yield int.from_bytes(ticket, "big")


def _isolated(space: Settled, step: Callable[[], Made]) -> Made:
    state = space.state()
    try:
        return step()
    finally:
        space.restore(state)


def _received(raw: bytes, kept: Mapping[int, object]) -> dict[int, Any]:
    try:
        found: dict[int, Any] = _Unpickler(io.BytesIO(raw), kept).load()
    except (EOFError, pickle.UnpicklingError):
        return {}
    return found


class _Pickler(pickle.Pickler):
    def __init__(self, file: Any, kept: Mapping[int, object]) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self._kept = kept

    def persistent_id(self, thing: object) -> int | None:
        return id(thing) if id(thing) in self._kept else None


class _Unpickler(pickle.Unpickler):
    def __init__(self, file: Any, kept: Mapping[int, object]) -> None:
        super().__init__(file)
        self._kept = kept

    def persistent_load(self, number: int) -> object:
        return self._kept[number]
