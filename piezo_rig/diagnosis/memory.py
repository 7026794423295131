"""Memory that is no longer used, given back to the system.

The matrices of one step of a diagnosis are of other sizes than those of the next, and are made by
several threads; the C library keeps what was freed for requests that hardly come again, half of
everything in a long recording. Elsewhere than on Linux the system does as it likes.
"""

from __future__ import annotations

import ctypes
import sys
from functools import cache
from typing import Any


@cache
def _library() -> Any:
    if not sys.platform.startswith("linux"):
        return None
    try:
        library = ctypes.CDLL("libc.so.6")
        library.malloc_trim.argtypes = [ctypes.c_size_t]
    except (OSError, AttributeError):  # another C library than GNU's
        return None
    return library


def give_back() -> None:
    """Give freed memory back; some milliseconds."""
    library = _library()
    if library is not None:
        library.malloc_trim(0)
