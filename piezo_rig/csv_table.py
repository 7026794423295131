"""CSV files of this program's own shape: a header with names and units, then numbers.

Strict on purpose: what is asked for here is played, so nothing is guessed. Lines that begin with
``#`` are comments, and pass. Recordings, which come in any shape, are read by
`piezo_rig.run_file.importers`.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezo_rig.errors import InputError

FloatArray = NDArray[np.float64]
LARGEST = 200_000_000  # bytes; a million rows have 40


def read_table_text(path: Path, what: str) -> str:
    """The text of a table; every failure is an ``InputError`` that names the file."""
    try:
        if path.stat().st_size > LARGEST:
            raise InputError("file-size", f"{path}: {path.stat().st_size} bytes",
                             f"too large for {what}", "give fewer rows")
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError("file-text", f"{path}: not UTF-8 text (byte {error.start})",
                         f"not {what}", f"give {what}") from None
    except FileNotFoundError:
        raise InputError("file-missing", f"{path}: no such file", "a slip in the name, or it was "
                         "moved", f"give {what}") from None
    except OSError as error:
        raise InputError("file-unreadable", f"{path}: {error.strerror or error}",
                         "a folder, or not yours to read", f"give {what}") from None


def table_lines(text: str) -> Iterator[tuple[int, str]]:
    """Number (from 1) and text of every line of a table that is neither blank nor a comment."""
    for number, line in enumerate(io.StringIO(text), start=1):
        begins = line.lstrip()
        if begins and not begins.startswith("#"):
            yield number, line.rstrip("\n")


def parse_table(text: str, columns: Sequence[str], name: str) -> list[FloatArray]:
    """The columns (n,) of a table, in the order asked for.

    Parameters
    ----------
    columns : the names that the header has, no others
    name : of the file, for the messages

    Raises
    ------
    InputError : another header, a row that is cut short, a cell that is no number
    """
    head, *rows = [line for _, line in table_lines(text)] or [""]
    found = [cell.strip().strip('"') for cell in head.split(",")]
    if sorted(found) != sorted(columns):
        raise InputError(
            "table-header", f"{name}: the header is {head.strip()[:80]!r}",
            "other columns or other units than expected, or no header at all",
            f"let the first line, but for comments (#), be {','.join(columns)}",
        )
    if not rows:
        return [np.empty(0) for _ in columns]
    try:
        table = np.loadtxt(rows, delimiter=",", ndmin=2, comments=None)
    except ValueError:
        raise _bad_row(text, len(columns), name) from None
    if table.shape[1] != len(columns):
        raise _bad_row(text, len(columns), name)
    return [np.ascontiguousarray(table[:, found.index(c)]) for c in columns]


def _bad_row(text: str, columns: int, name: str) -> InputError:
    """An error that names the first row at fault."""
    for line, row in [*table_lines(text)][1:]:
        cells = row.strip().split(",")
        try:
            numbers = [float(cell) for cell in cells]
        except ValueError:
            numbers = []
        if len(numbers) != columns:
            return InputError(
                "table-row", f"{name}:{line}: {row.strip()[:60]!r}, expected {columns} numbers "
                "with commas between them", "a cell is missing, or is not a number",
                "mend that row (a decimal point, not a comma)",
            )
    return InputError("table-row", f"{name}: not a table of {columns} columns",
                      "the file is damaged", "write it again")
