"""The headers of LabVIEW measurement files: keys, and values in the columns where they stand.

Header text is split, never evaluated.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from piezo_rig.errors import InputError
from piezo_rig.run_file.importers.guards import decoded
from piezo_rig.run_file.importers.number_table import split_cells

CODE = "import-lvm"
MAGIC = b"LabVIEW Measurement"
END = "***End_of_Header***"
_DATE = re.compile(r"(\d{4})[/.-](\d{1,2})[/.-](\d{1,2})")
_TIME = re.compile(r"(\d{1,2}):(\d{2}):(\d{2})(?:[.,](\d{1,40}))?")


@dataclass
class Lines:
    """A place in the text that moves on line by line and knows its number."""

    text: bytes
    position: int = 0
    number: int = 1

    def peek(self) -> bytes | None:
        if self.position >= len(self.text):
            return None
        end = self.text.find(b"\n", self.position)
        return self.text[self.position : len(self.text) if end < 0 else end]

    def take(self) -> bytes:
        line = self.peek() or b""
        self.position += len(line) + 1
        self.number += 1
        return line

    def take_until(self, position: int) -> bytes:
        block = self.text[self.position : position]
        self.position = position
        self.number += block.count(b"\n")
        return block


@dataclass
class Header:
    """Keys of a header, each with its values in the columns where they stand."""

    values: dict[str, list[str]] = field(default_factory=dict)

    def first(self, key: str) -> str:
        return next((value.strip() for value in self.values.get(key, []) if value.strip()), "")

    def at(self, key: str, column: int) -> str:
        """The value that stands at a column, else the first one of the key."""
        values = self.values.get(key, [])
        return values[column].strip() if column < len(values) and values[column].strip() else ""


def separator_of(text: bytes) -> str:
    """The character between cells: what follows the word ``Separator``, else a tab."""
    match = re.search(rb"^Separator([\t,; |])(\w*)", text[:20_000], re.M)
    if match is None:
        follows = text[len(MAGIC) : len(MAGIC) + 1]
        return follows.decode("latin-1") if follows in (b",", b";") else "\t"
    by_word = {"tab": "\t", "comma": ",", "semicolon": ";", "space": " "}
    return by_word.get(match[2].decode("latin-1").lower(), match[1].decode("latin-1"))


def read_header(path: Path, lines: Lines, separator: str) -> Header:
    header = Header()
    first = lines.number
    while (line := lines.peek()) is not None:
        if line.startswith(b"***Start_Special***"):
            skip_special(path, lines)
            continue
        cells = split_cells(decoded(lines.take()), separator)
        if cells[0].strip() == END:
            return header
        if cells[0].strip() and cells[0].strip() not in header.values:
            header.values[cells[0].strip()] = cells
            cells[0] = ""
    raise InputError(
        CODE,
        f"{path}: the header that begins at line {first} has no end",
        cause="the file was cut off, or is not a LabVIEW measurement file",
        remedy="copy it again from the computer that recorded it",
    )


def skip_hollow(path: Path, lines: Lines, separator: str) -> None:
    hollow = b" \t" + separator.encode()
    while (line := lines.peek()) is not None:
        if line.startswith(b"***Start_Special***"):
            skip_special(path, lines)
        elif line.strip(hollow):
            return
        else:
            lines.take()


def skip_special(path: Path, lines: Lines) -> None:
    first = lines.number
    while lines.peek() is not None:
        if lines.take().startswith(b"***End_Special***"):
            return
    raise InputError(
        CODE,
        f"{path}: the special block that begins at line {first} has no end",
        cause="the file was cut off",
    )


def number_of(path: Path, key: str, header: Header, column: int) -> float | None:
    """A number of the header, at the column of a channel or of its time column."""
    text = header.at(key, column) or header.at(key, max(column - 1, 0)) or header.first(key)
    text = text.replace(",", ".")
    if not text:
        return None
    if len(text) > 60 or not re.fullmatch(r"[+-]?\d+(\.\d*)?([eE][+-]?\d{1,3})?", text):
        raise InputError(
            CODE,
            f"{path}: {key} of column {column + 1} is {text[:40]!r}, not a number",
            cause="a damaged header",
        )
    value = float(text)
    if not np.isfinite(value) or abs(value) > 1e12:
        raise InputError(CODE, f"{path}: {key} of column {column + 1} is {text[:40]}")
    return value


def stamp_of(file_header: Header, header: Header, column: int, warnings: list[str]) -> float | None:
    """Date and time of a channel as seconds since 1970, read as UTC; None where unknown."""
    date, time = header.at("Date", column), header.at("Time", column)
    if not (date and time):
        date, time = header.first("Date"), header.first("Time")
    if not (date and time):
        date, time = file_header.first("Date"), file_header.first("Time")
    if not date and not time:
        return None
    day, clock = _DATE.fullmatch(date), _TIME.fullmatch(time)
    try:
        if day is None or clock is None:
            raise ValueError
        whole = datetime(*map(int, day.groups()), *map(int, clock.groups()[:3]), tzinfo=UTC)  # type: ignore[misc, arg-type]
    except (ValueError, OverflowError):
        warnings.append(
            f"date {date[:20]!r} and time {time[:20]!r} cannot be read; "
            "its place on the clock is unknown"
        )
        return None
    return whole.timestamp() + (float(f"0.{clock[4]}") if clock[4] else 0.0)
