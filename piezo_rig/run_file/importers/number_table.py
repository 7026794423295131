"""Rows of numbers in text, read fast when they are sound and cell by cell when they are not.

The fast way is NumPy's own reader. Wherever it balks, or could be fooled, every cell
is looked at, so that a message can name line and column. A cell is a number, is empty
(NaN), or is an error: nothing in a file is ever evaluated, and a number is never read
from half a cell.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from piezo_rig.errors import InputError
from piezo_rig.run_file.importers.guards import decoded
from piezo_rig.run_file.sweep import FloatArray

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,4})?")
_NO_NUMBER = frozenset(("nan", "-nan", "+nan", "inf", "-inf", "+inf", "infinity", "-infinity"))
_LONGEST_CELL = 80
_FIXED_DECIMALS = re.compile(r"[+-]?\d+\.(\d+)")
_ROWS_COMPARED = 20


@dataclass
class NumberTable:
    """The body of a text file: rows of cells, one line each.

    Parameters
    ----------
    path, code : for messages
    body : lines that end in LF
    first_line : 1-based line number of the first of them in the file
    separator : between cells
    decimal_comma : whether numbers are written with a comma
    names : one for each column that may be read
    most_cells : a row with more cells than this is an error; None allows any (comments)
    fewest_cells : a row with fewer cells is an error
    by_hand : written by a person's script, where lines are often joined without a last line
        end, not by a measurement that may have been cut off
    """

    path: Path
    code: str
    body: bytes
    first_line: int
    separator: str
    decimal_comma: bool
    names: Sequence[str]
    most_cells: int | None = None
    fewest_cells: int = 1
    by_hand: bool = False
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    _line_numbers: list[int] | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        self._drop_torn_row()
        self.body = self.body.rstrip(b"\n") + b"\n"
        if not self.body.strip(b" \t\n" + self.separator.encode()):
            raise InputError(
                self.code,
                f"{self.path}: holds no samples after line {self.first_line - 1}",
                cause="the recording was stopped at once, or the file was cut off",
            )

    # -- reading --------------------------------------------------------------

    def load(self, columns: Sequence[int]) -> list[FloatArray]:
        """The values of some columns (0-based), one array each, NaN where a cell is empty.

        Raises
        ------
        InputError : a cell that is not a number, or a row of the wrong width
        """
        values = self._fast(columns)
        if values is None:
            values = self._careful(columns)
        return [np.ascontiguousarray(values[:, i]) for i in range(len(columns))]

    def where(self, row: int) -> str:
        """The place of a row in the file, ``line 17``."""
        if self._line_numbers is None:
            self._line_numbers = [line for line, _ in self._lines()]
        if row < len(self._line_numbers):
            return f"line {self._line_numbers[row]}"
        return f"sample {row}"

    def blocks(self) -> tuple[int, ...]:
        """Rows that come after an empty line."""
        if b"\n\n" not in self.body and not self._has_hollow_lines():
            return ()
        starts, expected = [], self.first_line
        for row, (line, _) in enumerate(self._lines()):
            if line != expected and row > 0:
                starts.append(row)
            expected = line + 1
        return tuple(starts)

    def _fast(self, columns: Sequence[int]) -> FloatArray | None:
        body = self.body
        if b'"' in body or (self.decimal_comma and b"." in body) or not self._even_width(columns):
            return None
        if self.decimal_comma:
            body = body.replace(b",", b".")
        try:
            values = np.loadtxt(
                io.TextIOWrapper(io.BytesIO(body), encoding="latin-1", newline="\n"),
                delimiter=self.separator,
                comments=None,
                usecols=tuple(columns),
                ndmin=2,
                dtype=np.float64,
            )
        except (ValueError, OverflowError):
            return None
        return values if np.isfinite(values).all() else None

    def _even_width(self, columns: Sequence[int]) -> bool:
        """Whether every line has a sound number of cells (false also for empty lines)."""
        raw = np.frombuffer(self.body, dtype=np.uint8)
        ends = np.flatnonzero(raw == 10)
        separators = np.flatnonzero(raw == ord(self.separator))
        cells = np.diff(np.searchsorted(separators, ends), prepend=0) + 1
        most = self.most_cells
        return bool(
            cells.min() >= max(self.fewest_cells, max(columns) + 1)
            and (most is None or cells.max() <= most)
        )

    def _careful(self, columns: Sequence[int]) -> FloatArray:
        rows = [self._row(line, cells, columns) for line, cells in self._rows()]
        return np.array(rows, dtype=np.float64).reshape(len(rows), len(columns))

    def _row(self, line: int, cells: list[str], columns: Sequence[int]) -> list[float]:
        width = len(cells)
        if self.most_cells is not None:
            while width > self.most_cells and not cells[width - 1].strip():
                width -= 1
            if width > self.most_cells:
                raise self._fault(
                    line, f"has {width} cells under {len(self.names)} names", self._width_hint()
                )
        if width < self.fewest_cells:
            raise self._fault(line, f"has {width} of {self.fewest_cells} cells", "")
        return [self._number(line, i, cells[i]) if i < width else np.nan for i in columns]

    def _number(self, line: int, column: int, cell: str) -> float:
        text = cell.strip()
        if not text:
            return np.nan
        if self.decimal_comma:
            if "." in text:
                raise self._fault(
                    line,
                    f"column {self._name(column)}: {text[:40]!r} has a decimal point, "
                    "but numbers here have a decimal comma",
                    "a thousands separator, or a file joined from two dialects",
                )
            text = text.replace(",", ".")
        if len(text) <= _LONGEST_CELL and _NUMBER.fullmatch(text):
            return float(text)
        if text.lower() in _NO_NUMBER or text.startswith(("1.#", "-1.#")):
            return np.inf if "inf" in text.lower() else np.nan
        raise self._fault(
            line,
            f"column {self._name(column)}: {cell.strip()[:40]!r} is not a number",
            "the file is damaged, or its separators are not what they seem",
        )

    def _name(self, column: int) -> str:
        return f"'{self.names[column][:40]}'" if column < len(self.names) else str(column + 1)

    def _width_hint(self) -> str:
        if self.separator == ",":
            return "a decimal comma between cells that are separated by commas too"
        return "a damaged line, or a header that does not belong to these rows"

    def _fault(self, line: int, what: str, cause: str) -> InputError:
        return InputError(
            self.code,
            f"{self.path}: line {line} {what}",
            cause=cause,
            remedy="repair that line, or export the recording again (decimal point, or "
            "decimal comma with semicolons)",
        )

    # -- lines ----------------------------------------------------------------

    def _lines(self) -> Iterator[tuple[int, bytes]]:
        """Number and bytes of every line that holds a cell."""
        hollow = b" \t" + self.separator.encode()
        for number, line in enumerate(io.BytesIO(self.body), start=self.first_line):
            if line.rstrip(b"\n").strip(hollow):
                yield number, line

    def _rows(self) -> Iterator[tuple[int, list[str]]]:
        for number, line in self._lines():
            text = decoded(line.rstrip(b"\n"))
            yield number, split_cells(text, self.separator)

    def _has_hollow_lines(self) -> bool:
        pattern = rb"(?m)^[ \t" + re.escape(self.separator.encode()) + rb"]+$"
        return re.search(pattern, self.body) is not None

    def _drop_torn_row(self) -> None:
        """Drop a last row without line end where it was, or may have been, cut off.

        A row with all its cells is kept, unless its last number may be the beginning of another:
        shorter than the ones above it where these are of one length, or far from them.
        """
        if self.body.endswith(b"\n") or not self.body:
            return
        cut = self.body.rfind(b"\n") + 1
        torn = split_cells(decoded(self.body[cut:]), self.separator)
        before = self.body[:cut].rsplit(b"\n", _ROWS_COMPARED + 1)[-_ROWS_COMPARED - 1 :]
        rows = [split_cells(decoded(line), self.separator) for line in before if line.strip()]
        if self._whole(torn, rows):
            self.body += b"\n"
        elif self._complete(torn) and (self.by_hand or self._goes_on(torn, rows)):
            self.notes.append(
                "the last line has no line end; it has all its cells, so its sample was kept"
            )
            self.body += b"\n"
        else:
            line = self.first_line + self.body.count(b"\n")
            self.warnings.append(
                f"line {line} ends without a line end and may be cut off: that sample was dropped"
            )
            self.body = self.body[:cut]

    def _complete(self, torn: list[str]) -> bool:
        """Whether a row has as many numbers as there are columns, and no more."""
        return len(torn) == len(self.names) and all(
            _NUMBER.fullmatch(cell.strip().replace(",", ".")) for cell in torn
        )

    def _whole(self, torn: list[str], rows: list[list[str]]) -> bool:
        width = len(self.names)
        if len(torn) > width:
            return True
        if len(torn) < width or not rows:
            return False
        decimals = {_decimals(row[width - 1]) for row in rows if len(row) >= width}
        return decimals == {_decimals(torn[-1])} and None not in decimals

    def _goes_on(self, torn: list[str], rows: list[list[str]]) -> bool:
        """Whether every number of the last row lies as near to the row before as is usual."""
        width = len(self.names)
        if len(rows) < 3:
            return False
        decimals = {_decimals(row[width - 1]) for row in rows if len(row) >= width}
        if len(rows) > 3 and len(decimals) == 1 and None not in decimals:
            return False  # of one length but for this one
        try:
            table = np.array([[_plain_number(c) for c in row] for row in [*rows, torn]])
        except ValueError:
            return False
        with np.errstate(over="ignore", invalid="ignore"):  # numbers near the largest there is
            steps = np.abs(np.diff(table, axis=0))
            return bool(np.all(steps[-1] <= 2.0 * steps[:-1].max(axis=0)))


def split_cells(line: str, separator: str) -> list[str]:
    """The cells of one line, quotation marks removed."""
    if '"' not in line:
        return line.split(separator)
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True), [""])
    except csv.Error:
        return line.split(separator)


def _decimals(cell: str) -> int | None:
    match = _FIXED_DECIMALS.fullmatch(cell.strip().replace(",", "."))
    return len(match[1]) if match else None


def _plain_number(cell: str) -> float:
    return float(cell.strip().replace(",", "."))
