"""Tries a file in a child process first: HDF5 crashes on some damage, and loops on other.

The child reads all that a reader may read. If it dies, the file is refused; the program goes on.
What the child finds wrong in words is not its business: the reader finds it again.
"""

from __future__ import annotations

import contextlib
import faulthandler
import os
import sys
import warnings
from pathlib import Path

import h5py

from piezo_rig.run_file.guarded import HDF5_ERRORS, Budget, Damaged, child, names, numbers, text
from piezo_rig.run_file.layout import PART_SUFFIX

try:
    import resource
except ImportError:  # no such system has os.fork either
    resource = None  # type: ignore[assignment]

_DEPTH = 4
_MOST_ATTRIBUTES = 200
_WHOLE_BYTES = 16_000_000  # larger files: headers and texts, not the rows
_proven: set[tuple[str, int, int]] = set()


def how(path: Path) -> dict[str, bool]:
    """How a file is opened: one that is being recorded without a lock, which its writer could meet.

    Single-writer mode keeps it whole for readers without one.
    """
    return {"swmr": True, "locking": False} if path.name.endswith(PART_SUFFIX) else {}


def refuse_what_crashes(path: Path) -> None:
    """OSError for a file on which the library dies, or does not end; each file is tried once."""
    stat = path.stat()
    key = (str(path.resolve()), stat.st_mtime_ns, stat.st_size)
    if key in _proven or not hasattr(os, "fork") or resource is None:
        return
    with warnings.catch_warnings():
        # Some Python versions warn of threads; the child only reads, and takes no lock of theirs.
        warnings.simplefilter("ignore", DeprecationWarning)
        pid = os.fork()
    if pid == 0:
        _try(path, stat.st_size)
    _, status = os.waitpid(pid, 0)
    if os.WIFSIGNALED(status):
        raise OSError("damaged in a way on which the HDF5 library breaks down")
    if len(_proven) > 1000:
        _proven.clear()
    _proven.add(key)


def _try(path: Path, size: int) -> None:
    """The child: read, and end; never returns."""
    sys.settrace(None)
    try:
        faulthandler.disable()
        seconds = 2 + size // 20_000_000
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        with h5py.File(path, "r", **how(path)) as f:
            _read(f, Budget(path), _DEPTH, size < _WHOLE_BYTES, set())
    except BaseException:
        pass
    finally:
        os._exit(0)


def _read(
    group: h5py.Group, budget: Budget, depth: int, rows: bool, seen: set[int]
) -> None:
    """Attributes, texts and rows of a group and of what is below it, each object once."""
    _attributes(group)
    for name in names(group):
        try:
            thing = child(group, name, (h5py.Group, h5py.Dataset))
            if thing is None or hash(thing.id) in seen:
                continue
            seen.add(hash(thing.id))
            if isinstance(thing, h5py.Group):
                if depth:
                    _read(thing, budget, depth - 1, rows, seen)
                continue
            _attributes(thing)
            if thing.shape == ():
                text(group, name)
            elif rows:
                numbers(group, name, budget)
        except (*HDF5_ERRORS, Damaged):
            continue


def _attributes(thing: h5py.Group | h5py.Dataset) -> None:
    for key in list(thing.attrs)[:_MOST_ATTRIBUTES]:
        with contextlib.suppress(*HDF5_ERRORS):
            _ = thing.attrs[key]
