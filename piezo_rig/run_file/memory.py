"""A bound on the memory that reading one file may take, whatever library asks for it.

HDF5 believes the lengths that stand in a file: one flipped bit in the length of a text makes it
ask for gigabytes. Under a bound it is refused them, and says so.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import resource
except ImportError:  # not on this system: what the reader itself checks has to do
    resource = None  # type: ignore[assignment]

_STATM = Path("/proc/self/statm")


@contextmanager
def bounded(extra_bytes: int) -> Iterator[None]:
    """Inside, the process may grow by no more than this; without effect where Linux is not.

    Nested bounds do not add up: the outer one stays. A lower limit of the system stays too.
    """
    size = _address_space()
    if resource is None or size is None:
        yield
        return
    before = resource.getrlimit(resource.RLIMIT_AS)
    if before[0] not in (-1, resource.RLIM_INFINITY):
        yield
        return
    with suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_AS, (size + extra_bytes, before[1]))
    try:
        yield
    finally:
        with suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_AS, before)


def _address_space() -> int | None:
    """Bytes of address space of this process."""
    try:
        return int(_STATM.read_text().split()[0]) * resource.getpagesize()
    except (OSError, ValueError, AttributeError):
        return None
