"""Reads measured points: a CSV with pairs of columns, each of which may be empty in a row."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezo_rig.csv_table import table_lines
from piezo_rig.errors import InputError
from piezo_rig.resources import read_text

CODE = "calibration-points"
COLUMNS = {
    "amplifier": ("command_v", "drive_v", "drive_u_v"),
    "interferometer": ("sensor_v", "displacement_um", "displacement_u_um"),
}
"""By instrument: what was set or read, the reference, and the reference's standard uncertainty."""
_KNOWN = tuple(name for names in COLUMNS.values() for name in names)
_LARGEST = 1e9
MOST_UNEQUAL = 1e4
"""Of stated uncertainties: beyond it one point alone would be the line."""


@dataclass(frozen=True, eq=False)
class Points:
    """Measured pairs of one instrument.

    Attributes
    ----------
    instrument : ``amplifier`` or ``interferometer``
    x : (n,) V of command or sensor
    y : (n,) V of drive, or um of displacement
    u : (n,) standard uncertainty of y in its unit; None where the file states none
    lines : (n,) lines of the file
    path : of the file
    """

    instrument: str
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    u: NDArray[np.float64] | None
    lines: tuple[int, ...]
    path: str

    @property
    def names(self) -> tuple[str, str]:
        """The columns of x and y."""
        return COLUMNS[self.instrument][:2]

    @property
    def unit(self) -> str:
        """Of y."""
        return "V" if self.instrument == "amplifier" else "um"


def read_points(path: Path) -> list[Points]:
    """The pairs in a file, for every instrument that it has columns of.

    Commas, semicolons or tabs between cells; decimal commas where the separator is another;
    comment lines begin with ``#``.

    Raises
    ------
    InputError : no such columns, an unknown column, or a cell that is no number
    """
    rows = _rows(path)
    if not rows:
        raise _bad(path, "holds no points", "it is empty")
    line, header = rows[0]
    names = [cell.strip().lower() for cell in header]
    while names and not names[-1]:
        names.pop()
    _check_header(path, line, names)
    columns = {name: names.index(name) for name in names}
    table = [(number, _numbers(path, number, cells, names)) for number, cells in rows[1:]]
    found = []
    for instrument, (x, y, u) in COLUMNS.items():
        if x not in columns:
            continue
        taken = [
            (number, row[columns[x]], row[columns[y]], row[columns[u]] if u in columns else None)
            for number, row in table
            if _paired(path, number, row[columns[x]], row[columns[y]], x, y)
        ]
        if not taken:
            raise _bad(path, f"has columns {x} and {y}, but no point", "the rows are empty")
        stated = None
        if u in columns:
            for number, _, _, value in taken:
                if value is None or not value > 0:
                    raise _bad(path, f"line {number}: {u} is not a positive number",
                               "a standard uncertainty is missing",
                               f"state {u} for every point, or leave the column out")
            stated = np.array([value for _, _, _, value in taken], float)
            if stated.max() > MOST_UNEQUAL * stated.min():
                raise _bad(path, f"{u} goes from {stated.min():.3g} to {stated.max():.3g}",
                           "another unit in some rows", "state all of them in the unit of the name")
        found.append(Points(
            instrument, np.array([p[1] for p in taken], float),
            np.array([p[2] for p in taken], float), stated, tuple(p[0] for p in taken), str(path),
        ))
    return found


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Line number and cells of every line that holds something."""
    text = read_text(path, "file of points (CSV)")
    body = [(n, s) for n, s in table_lines(text) if s.strip(" ,;\t")]
    if not body:
        return []
    separator = max(";\t,", key=body[0][1].count)
    rows = []
    for number, line in body:
        try:
            cells = next(csv.reader(io.StringIO(line), delimiter=separator))
        except (csv.Error, StopIteration) as error:
            raise _bad(path, f"line {number}: {error}", "not a table of points") from None
        rows.append((number, [c.replace(",", ".") if separator != "," else c for c in cells]))
    return rows


def _check_header(path: Path, line: int, names: list[str]) -> None:
    wanted = "command_v,drive_v and/or sensor_v,displacement_um"
    for name in names:
        if name not in _KNOWN:
            raise _bad(path, f"line {line}: '{name[:40]}' is not a column of points",
                       "another unit, a slip in the name, or a missing header line",
                       f"name the columns {wanted} (volts and micrometres), if known with "
                       "drive_u_v, displacement_u_um")
        if names.count(name) > 1:
            raise _bad(path, f"line {line}: column {name} stands there twice", "a slip")
    complete = False
    for x, y, u in COLUMNS.values():
        if (x in names) != (y in names) or (u in names and y not in names):
            missing = [n for n in (x, y) if n not in names]
            raise _bad(path, f"line {line}: column {' and '.join(missing)} is missing",
                       "half of a pair", f"give both {x} and {y}")
        complete = complete or x in names
    if not complete:
        raise _bad(path, f"line {line}: no columns of points", "a missing header line",
                   f"give {wanted}")


def _numbers(
    path: Path, number: int, cells: list[str], names: list[str]
) -> list[float | None]:
    if any(cell.strip() for cell in cells[len(names):]):
        raise _bad(path, f"line {number}: {len(cells)} cells under {len(names)} columns",
                   "a decimal comma between commas, or a slip", "use decimal points")
    row: list[float | None] = []
    for name, cell in zip(names, [*cells, *[""] * len(names)], strict=False):
        text = cell.strip()
        try:
            value = float(text) if text else None
        except ValueError:
            value = math.nan
        if value is not None and not abs(value) < _LARGEST:
            raise _bad(path, f"line {number}: {name} is {text[:40]!r}, not a number",
                       "a unit or a word in a cell", "write plain numbers in volts or micrometres")
        row.append(value)
    return row


def _paired(
    path: Path, number: int, x: float | None, y: float | None, x_name: str, y_name: str
) -> bool:
    if (x is None) != (y is None):
        raise _bad(path, f"line {number}: {x_name if x is None else y_name} is empty",
                   "half of a point", "complete the point, or take the line out")
    return x is not None


def _bad(path: Path, what: str, cause: str, remedy: str = "mend the file") -> InputError:
    return InputError(CODE, f"{path}: {what}", cause, remedy)
