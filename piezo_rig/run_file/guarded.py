"""HDF5 read with care: nothing in a file leads elsewhere, runs code, or is larger than it looks.

A run holds hard links, plain numbers, short texts, and the filters shuffle, gzip and fletcher32.
Whatever else a file holds is refused before it is read: links into other files, virtual and
external datasets, other filters (HDF5 would look for a plug-in), shapes whose values were never
written, and compressed pieces that swell beyond their size.
"""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

# What HDF5 and its Python binding raise on damaged files.
HDF5_ERRORS = (
    OSError, KeyError, RuntimeError, TypeError, ValueError, AttributeError, MemoryError,
    OverflowError, IndexError, NotImplementedError, ZeroDivisionError, zlib.error,
)  # fmt: skip
MOST_LINKS = 20_000
MOST_ATTRIBUTES = 200
LONGEST_TEXT = 5_000_000  # bytes
_FLOOR = 64_000_000  # bytes in memory that a file of any size may ask for
RATIO = 64  # and what it may ask for per byte on the disk; recorded volts reach about 5
_SHUFFLE, _GZIP, _FLETCHER = h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_DEFLATE, (
    h5py.h5z.FILTER_FLETCHER32
)  # fmt: skip
_PIPELINE = (_SHUFFLE, _GZIP, _FLETCHER)


class Damaged(Exception):
    """A piece of a file that cannot be read, or must not be; the text says why."""


class Budget:
    """Bytes of memory that one file may still ask for."""

    def __init__(self, path: Path) -> None:
        self.file_bytes = path.stat().st_size
        self._left = max(_FLOOR, RATIO * self.file_bytes)

    def take(self, count: int) -> None:
        """Count values (8 bytes each) against the budget; Damaged when it is spent."""
        self._left -= 8 * count
        if self._left < 0:
            raise Damaged("asks for far more memory than a file of its size can fill")


def first_line(error: BaseException) -> str:
    """What an error says, in one line fit for a terminal."""
    text = (str(error).strip("'\" ").splitlines() or [""])[0] or type(error).__name__
    return one_line(text)


def one_line(text: str) -> str:
    """A text out of a file as one line that does nothing to a terminal."""
    return "".join(c if c.isprintable() else "?" for c in text[:200])


def names(group: h5py.Group) -> list[str]:
    """Names of what a group holds, sorted; Damaged when there are absurdly many."""
    if len(group) > MOST_LINKS:
        raise Damaged(f"{group.name} holds {len(group)} things")
    return sorted(group)


def child(group: h5py.Group, name: str, kind: type | tuple[type, ...]) -> Any:
    """The group or dataset of that name, None where there is none.

    Raises
    ------
    Damaged : a link that leads elsewhere, something of another kind, or nothing readable
    """
    try:
        link = group.get(name, getlink=True)
        if link is None:
            return None
        if not isinstance(link, h5py.HardLink):
            raise Damaged(f"{name} is a link that leads elsewhere; a run has none")
        found = group[name]
    except HDF5_ERRORS as error:
        raise Damaged(f"{name} cannot be read: {first_line(error)}") from None
    if not isinstance(found, kind):
        raise Damaged(f"{name} is a {type(found).__name__.lower()}")
    return found


def attributes(thing: h5py.Group | h5py.Dataset) -> dict[str, Any]:
    """Its attributes that are one number or one text; others, and unreadable ones, are left out."""
    found: dict[str, Any] = {}
    try:
        keys = list(thing.attrs)[:MOST_ATTRIBUTES]
    except HDF5_ERRORS as error:
        raise Damaged(f"its attributes cannot be read: {first_line(error)}") from None
    for key in keys:
        try:
            value = plain(thing.attrs[key])
        except HDF5_ERRORS:
            continue
        if isinstance(value, str | int | float | bool):
            found[key] = value
    return found


def plain(value: Any) -> Any:
    """An HDF5 attribute or scalar as a Python value."""
    if isinstance(value, bytes):
        return value.decode()
    if isinstance(value, np.generic):
        return plain(value.item())
    return value


def text(group: h5py.Group, name: str) -> str | None:
    """A text that stands in the group under that name; None where there is none."""
    dataset = child(group, name, h5py.Dataset)
    if dataset is None:
        return None
    if dataset.shape != () or dataset.dtype.kind not in "SO":
        raise Damaged(f"{name} is not a text")
    if dataset.dtype.itemsize > LONGEST_TEXT:
        raise Damaged(f"{name} is a text of {dataset.dtype.itemsize} bytes")
    try:
        _refuse_strange_storage(dataset)
        value = dataset[()]
        return value.decode() if isinstance(value, bytes) else str(value)
    except HDF5_ERRORS as error:
        raise Damaged(f"{name} cannot be read: {first_line(error)}") from None


def numbers(
    group: h5py.Group, name: str, budget: Budget, kinds: str = "fiu"
) -> NDArray[Any] | None:
    """A row of numbers, shape (n,), in its own type; None where there is none.

    Raises
    ------
    Damaged : not a row of numbers, not all there, wrong checksums, or more than the budget allows
    """
    dataset = child(group, name, h5py.Dataset)
    if dataset is None:
        return None
    try:
        if dataset.dtype.kind not in kinds or dataset.dtype.itemsize > 16:
            raise Damaged(f"{name} holds {dataset.dtype}, not numbers")
        if dataset.shape is None or len(dataset.shape) != 1:
            raise Damaged(f"{name} has the shape {dataset.shape}, not one row")
        budget.take(dataset.size)
        _refuse_strange_storage(dataset)
        if dataset.chunks is not None:
            _check_chunks(dataset, name, budget)
        elif dataset.size and not 0 < dataset.id.get_storage_size() <= budget.file_bytes:
            raise Damaged(f"{name} was never written")
        return np.asarray(dataset[...])
    except HDF5_ERRORS as error:
        what = first_line(error)
        if "fletcher" in what.lower() or "checksum" in what.lower():
            what = "the checksum does not match"
        raise Damaged(f"{name} cannot be read, its data are damaged: {what}") from None


def _refuse_strange_storage(dataset: h5py.Dataset) -> None:
    """Refuse values that stand in other files, and filters that no run has."""
    made = dataset.id.get_create_plist()
    if made.get_layout() == h5py.h5d.VIRTUAL or made.get_external_count() > 0:
        raise Damaged("its values stand in another file; a run holds its own")
    filters = [made.get_filter(i)[0] for i in range(made.get_nfilters())]
    if filters != [f for f in _PIPELINE if f in filters]:
        raise Damaged(f"it is packed with the filters {filters}; a run has none but {_PIPELINE}")


def _check_chunks(dataset: h5py.Dataset, name: str, budget: Budget) -> None:
    """Every chunk is on the disk, and none is larger inside than its shape says."""
    size = int(dataset.chunks[0])
    due = -(-dataset.size // size)
    budget.take(size)
    stored: list[Any] = []
    if dataset.size:
        dataset.id.chunk_iter(stored.append)
    inside = [c for c in stored if c.chunk_offset[0] < dataset.size]
    if len(inside) != due:
        raise Damaged(f"{name}: {len(inside)} of {due} pieces were written; the rest is missing")
    made = dataset.id.get_create_plist()
    filters = [made.get_filter(i)[0] for i in range(made.get_nfilters())]
    if _GZIP not in filters:
        return
    most = size * dataset.dtype.itemsize
    skipped = 1 << filters.index(_GZIP)
    for chunk in inside:
        if chunk.filter_mask & skipped:
            continue
        _, packed = dataset.id.read_direct_chunk(chunk.chunk_offset)
        unpacked = zlib.decompressobj().decompress(packed, most + 1)
        if len(unpacked) != most:
            raise Damaged(f"{name}: a packed piece does not have its size; damaged")
