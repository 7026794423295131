"""One program at a time holds a generator: a second run, or one that is started while the guard
of a killed run still waits for its burst, is refused before it sends anything.

The lock is the system's (`flock`), so that it is gone when its holders are.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from drivers.clock import RealClock
from drivers.errors import InstrumentError
from piezo_rig.guard.orders import GIVE_UP_S

WAIT_S = 3.0
"""A run that has just ended needs a moment to let go."""

Tell = Callable[[str], None]


def lock_path(address: str) -> Path:
    """The file that stands for a generator on this computer."""
    name = hashlib.sha256(address.strip().upper().encode()).hexdigest()[:16]
    return Path(tempfile.gettempdir()) / f"piezo-rig-generator-{name}.lock"


def hold(address: str, tell: Tell = lambda text: None, wait_s: float = WAIT_S) -> int:
    """Take hold of a generator; returns a file descriptor, which holds it while it is open.

    Waits for the guard of a run that was killed, but not for a run that plays.
    ``wait_s`` is the time that a run which is ending gets. A temporary folder that takes no file
    locks nothing: -1.

    Raises
    ------
    InstrumentError : bench-busy
    """
    try:
        descriptor = _open(lock_path(address))
    except OSError:
        return -1
    try:
        _wait(descriptor, address, tell, wait_s)
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, str(os.getpid()).encode(), 0)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _open(path: Path) -> int:
    """Of any user: another's file is opened, one's own is left open to others; no link is."""
    flags = os.O_RDWR | os.O_NOFOLLOW  # what stands in a shared folder is written to
    with contextlib.suppress(FileNotFoundError):
        return os.open(path, flags)  # with O_CREAT, /tmp may refuse another user's file
    descriptor = os.open(path, flags | os.O_CREAT, 0o666)
    with contextlib.suppress(OSError):
        os.fchmod(descriptor, 0o666)
    return descriptor


def _wait(descriptor: int, address: str, tell: Tell, wait_s: float) -> None:
    clock, begun, told = RealClock(), time.monotonic(), False
    while True:
        with contextlib.suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        waited = time.monotonic() - begun
        if waited >= (wait_s if _holder_lives(descriptor) else GIVE_UP_S):
            raise InstrumentError(
                "bench-busy", "waveform_dac",
                f"another program holds the generator at {address}",
                "another run plays on it", "wait until it is done, then run again",
            )
        if waited > 0.5 and not told:
            told = True
            tell("waiting for another run, or its guard, to let go of the generator")
        clock.sleep(0.02)


def _holder_lives(descriptor: int) -> bool:
    """Whether the run that took the lock still runs; if not, its guard holds it."""
    try:
        holder = int(os.pread(descriptor, 20, 0))
        os.kill(holder, 0)
    except (ValueError, ProcessLookupError):
        return False
    except PermissionError:
        return True
    try:  # dead, but nobody has asked yet how it died
        return Path(f"/proc/{holder}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (OSError, IndexError):
        return True
