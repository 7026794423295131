"""Independent steps of a diagnosis, by two processes at a time.

Most of a diagnosis is many short steps that hold the interpreter's lock, so threads hardly help.
A forked process has all that its parent knows and hands back only what it found. Where there is
one processor, no fork, or this process is itself one of several, the steps are done one after the
other; what comes out is the same, because each begins with the space as it was.
"""

from __future__ import annotations

import io
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


class _State:
    """Of this process: whether several steps are under way."""

    busy = False


def alone() -> bool:
    """Whether the other processor has nothing to do."""
    return not _State.busy


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
    if _State.busy or not worth_it():
        return [_isolated(space, step) for step in steps]
    kept = {id(o): o for o in (space, *known)}
    with _busy(), _Tickets(len(steps)) as tickets:

        def taken(out: BinaryIO) -> None:
            made = {}
            for k in tickets:
                with suppress(Exception):
                    made[k] = _isolated(space, steps[k])
            _Pickler(out, kept).dump(made)

        try:
            child = Forked(taken)
        except OSError:  # no room for another process
            return [_isolated(space, step) for step in steps]
        found: dict[int, Any] = {}
        with child:
            for k in tickets:
                found[k] = _isolated(space, steps[k])
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
def _busy() -> Iterator[None]:
    _State.busy = True
    try:
        yield
    finally:
        _State.busy = False


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
