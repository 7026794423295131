"""Looks at the heaps of an HDF5 file before HDF5 does.

Texts of no fixed length stand in global heaps (``GCOL``). HDF5 2.0 walks such a heap by the sizes
that stand in it, and walks for ever where one says 0. Found by `make study-fuzz`.

Layout, from the HDF5 file format specification 3.0, III.E: signature, version 1, three zero bytes,
size of the collection; then objects: index, reference count (2 bytes each), four reserved bytes,
size (8 bytes), data padded to 8. Index 0 is what is free, and its size includes its head.
"""

from __future__ import annotations

import mmap
import struct
from pathlib import Path

SIGNATURE = b"\x89HDF\r\n\x1a\n"
_HEAP = b"GCOL\x01\0\0\0"
_SIZE = struct.Struct("<Q")
_OBJECT = struct.Struct("<HHLQ")


def refuse_broken_heaps(path: Path) -> None:
    """OSError for a file whose heaps could not be walked, or whose numbers have other sizes."""
    with path.open("rb") as handle:
        if path.stat().st_size < 48:
            raise OSError("shorter than any HDF5 file")
        with mmap.mmap(handle.fileno(), 0, access=mmap.ACCESS_READ) as data:
            if data[:8] != SIGNATURE:
                raise OSError("not an HDF5 file")
            version = data[8]
            sizes = data[13:15] if version < 2 else data[9:11]
            if sizes != b"\x08\x08":
                raise OSError("an HDF5 file with offsets or lengths of other than 8 bytes")
            at = data.find(_HEAP)
            while at >= 0:
                _walk(data, at)
                at = data.find(_HEAP, at + 1)


def _walk(data: mmap.mmap, start: int) -> None:
    if start + 16 > len(data):
        return
    (size,) = _SIZE.unpack_from(data, start + 8)
    end = start + size
    if end > len(data):
        raise OSError(f"its heap at byte {start} goes beyond the end of the file")
    at = start + 16
    while at + _OBJECT.size <= end:
        index, _, _, length = _OBJECT.unpack_from(data, at)
        step = length if index == 0 else _OBJECT.size + (length + 7) // 8 * 8
        if step < _OBJECT.size or at + step > end:
            raise OSError(f"its heap at byte {start} is damaged at byte {at}")
        at += step
