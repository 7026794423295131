"""LabVIEW measurement files (.lvm): headers, segments, and the rows between them.

Written against National Instruments' description of the format and against files as
they occur: a file header, ``***End_of_Header***``, then segments with headers of their
own; blocks of rows without a header after an empty line; special blocks; comment
columns; decimal commas that only versions from 2.0 on announce; files with no header
at all. Header text is split, never evaluated.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np

from piezo_rig.errors import InputError
from piezo_rig.run_file.importers.guards import (
    decoded,
    read_bytes,
    refuse_mislabelled,
    text_bytes,
)
from piezo_rig.run_file.importers.number_table import NumberTable, split_cells
from piezo_rig.run_file.importers.recording import Column, Recording
from piezo_rig.run_file.sweep import FloatArray

CODE = "import-lvm"
MAGIC = b"LabVIEW Measurement"
END = "***End_of_Header***"
MOST_SEGMENTS = 5000
MOST_COLUMNS = 2000
_EPOCH_1904_S = 2_082_844_800.0  # 1904-01-01 to 1970-01-01
_ABSOLUTE_FROM_S = 1e9  # a time above this is no time since the start of a recording
_NEXT_HEADER = re.compile(rb"^(?:\*\*\*|Channels[\t,; ]|LabVIEW Measurement)", re.M)
_DATE = re.compile(r"(\d{4})[/.-](\d{1,2})[/.-](\d{1,2})")
_TIME = re.compile(r"(\d{1,2}):(\d{2}):(\d{2})(?:[.,](\d{1,40}))?")


def read_lvm(path: Path) -> list[Recording]:
    """The segments of a LabVIEW measurement file.

    Raises
    ------
    InputError : not such a file, or damaged beyond a part that can be used
    """
    data = read_bytes(path)
    refuse_mislabelled(path, data, own=MAGIC)
    text, warnings = text_bytes(path, data, CODE)
    if not text.startswith(MAGIC):
        recordings = [_headerless(path, text)]
    else:
        recordings = _with_header(path, text)
    recordings[0].warnings[:0] = warnings
    return recordings


@dataclass
class _Lines:
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
class _Header:
    """Keys of a header, each with its values in the columns where they stand."""

    values: dict[str, list[str]] = field(default_factory=dict)

    def first(self, key: str) -> str:
        return next((value.strip() for value in self.values.get(key, []) if value.strip()), "")

    def at(self, key: str, column: int) -> str:
        """The value that stands at a column, else the first one of the key."""
        values = self.values.get(key, [])
        return values[column].strip() if column < len(values) and values[column].strip() else ""


def _with_header(path: Path, text: bytes) -> list[Recording]:
    lines = _Lines(text)
    separator = _separator(text)
    file_header = header = _Header()
    names: list[str] | None = None
    recordings: list[Recording] = []
    while True:
        own_header = False
        _skip_hollow(path, lines, separator)
        line = lines.peek()
        if line is None:
            break
        if line.startswith(MAGIC):
            file_header = header = _read_header(path, lines, separator)
            continue
        if len(recordings) >= MOST_SEGMENTS:
            raise InputError(CODE, f"{path}: has more than {MOST_SEGMENTS} segments")
        if not _looks_numeric(line, separator):
            own_header = True
            # A complete header ends in its own mark; the names of the columns follow it.
            if not line.startswith(b"X_Value"):
                header = _read_header(path, lines, separator)
                _skip_hollow(path, lines, separator)
            if lines.peek() is not None and not _looks_numeric(lines.peek() or b"", separator):
                names = split_cells(decoded(lines.take()), separator)
            else:
                names = None
        start = lines.number
        match = _NEXT_HEADER.search(text, lines.position)
        body = lines.take_until(match.start() if match else len(text))
        if not body.strip():
            raise InputError(
                CODE,
                f"{path}: holds no samples after line {start - 1}",
                cause="the recording was stopped at once, or the file was cut off",
            )
        recording = _segment(path, file_header, header, names, body, start, separator)
        continues = bool(recordings) and not own_header
        recordings.append(replace(recording, continues=continues))
    if not recordings:
        raise InputError(
            CODE,
            f"{path}: holds headers but no samples",
            cause="the recording was stopped at once, or the file was cut off",
        )
    return recordings


def _separator(text: bytes) -> str:
    """The character between cells: what follows the word ``Separator``, else a tab."""
    match = re.search(rb"^Separator([\t,; |])(\w*)", text[:20_000], re.M)
    if match is None:
        follows = text[len(MAGIC) : len(MAGIC) + 1]
        return follows.decode("latin-1") if follows in (b",", b";") else "\t"
    by_word = {"tab": "\t", "comma": ",", "semicolon": ";", "space": " "}
    return by_word.get(match[2].decode("latin-1").lower(), match[1].decode("latin-1"))


def _read_header(path: Path, lines: _Lines, separator: str) -> _Header:
    header = _Header()
    first = lines.number
    while (line := lines.peek()) is not None:
        if line.startswith(b"***Start_Special***"):
            _skip_special(path, lines)
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


def _skip_hollow(path: Path, lines: _Lines, separator: str) -> None:
    hollow = b" \t" + separator.encode()
    while (line := lines.peek()) is not None:
        if line.startswith(b"***Start_Special***"):
            _skip_special(path, lines)
        elif line.strip(hollow):
            return
        else:
            lines.take()


def _skip_special(path: Path, lines: _Lines) -> None:
    first = lines.number
    while lines.peek() is not None:
        if lines.take().startswith(b"***End_Special***"):
            return
    raise InputError(
        CODE,
        f"{path}: the special block that begins at line {first} has no end",
        cause="the file was cut off",
    )


def _looks_numeric(line: bytes, separator: str) -> bool:
    """Whether a line is a row of samples: its first filled cell begins a number."""
    cells = [cell.strip() for cell in split_cells(decoded(line), separator)]
    filled = next((cell for cell in cells if cell), "")
    return re.match(r"[+-]?[.,]?\d|[+-]?nan|[+-]?inf", filled, re.I) is not None


def _segment(
    path: Path,
    file_header: _Header,
    header: _Header,
    names: list[str] | None,
    body: bytes,
    first_line: int,
    separator: str,
) -> Recording:
    warnings: list[str] = []
    first_row = split_cells(decoded(body[: body.find(b"\n") + 1 or None].rstrip(b"\n")), separator)
    multi, width, lead = _layout(path, file_header, header, names, first_row)
    x_columns = range(0, width, 2) if multi else range(lead)
    empty_x = not multi and (
        file_header.first("X_Columns").lower() == "no" or not first_row[0].strip()
    )
    columns = []
    for i in range(width):
        at = i + 1 - lead  # headers keep a cell for their key, whether or not rows do
        name = names[i].strip() if names is not None and i < len(names) else ""
        if i in x_columns:
            columns.append(Column(name or "X_Value", is_time=True))
            continue
        step = _number(path, "Delta_X", header, at)
        columns.append(
            Column(
                name or f"column {i + 1}",
                time_column=None if empty_x else (i - 1 if multi else 0),
                step_s=step if step is not None and step > 0 else None,
                first_s=_number(path, "X0", header, at) or 0.0,
                stamp=_stamp(file_header, header, at, warnings),
            )
        )
    table = NumberTable(
        path=path,
        code=CODE,
        body=body,
        first_line=first_line,
        separator=separator,
        decimal_comma=_decimal_comma(file_header, body, separator),
        names=[column.name for column in columns],
        most_cells=width + 1 if separator == "," else None,
    )
    breaks = table.blocks()
    warnings += table.warnings
    warnings += [
        f"{table.where(row)} begins a block of rows without a header of its own; "
        "the header before it was used"
        for row in breaks[:3]
    ]
    _compare_count(header, table, warnings)
    return Recording(
        path=path,
        kind="lvm",
        columns=tuple(columns),
        load=partial(_load, table, frozenset(x_columns)),
        where=table.where,
        positional=True,
        breaks=breaks,
        warnings=list(dict.fromkeys(warnings)),
    )


def _load(
    table: NumberTable, time_columns: frozenset[int], columns: Sequence[int]
) -> list[FloatArray]:
    """Load columns; times that count from 1904 become seconds since 1970."""
    values = table.load(columns)
    for position, column in enumerate(columns):
        if column in time_columns and values[position][0] > _ABSOLUTE_FROM_S:
            values[position] = values[position] - _EPOCH_1904_S
    return values


def _layout(
    path: Path,
    file_header: _Header,
    header: _Header,
    names: list[str] | None,
    first_row: list[str],
) -> tuple[bool, int, int]:
    """Whether every channel has its own time column, how many columns of numbers, and
    whether the first of them is (1) or is not (0) a time column, filled or empty."""
    declared = file_header.first("X_Columns").lower()
    multi = declared == "multi" or (
        not declared and names is not None and sum(n.strip() == "X_Value" for n in names) > 1
    )
    text = header.first("Channels")
    channels = int(text) if re.fullmatch(r"\d{1,6}", text) else None
    if channels is None:
        named = names if names is not None else first_row
        comment = names is not None and named[-1].strip() in ("Comment", "")
        width = len(named) - (1 if comment else 0)
    else:
        width = 2 * channels if multi else channels + 1
    named_width = sum(n.strip() not in ("", "Comment") for n in names or ())
    lead = 1
    if declared == "no" and channels is not None and names is not None:
        lead = 0 if named_width == channels and names[0].strip() != "X_Value" else 1
    width -= 1 - lead
    if names is not None and width > len(names):
        raise InputError(
            CODE,
            f"{path}: the header announces {channels} channels, but only {len(names)} "
            "columns are named",
            cause="a damaged header",
        )
    if not 2 <= width <= MOST_COLUMNS:
        raise InputError(
            CODE,
            f"{path}: has {max(width, 0)} columns; a recording has 2 to {MOST_COLUMNS}",
            cause="a damaged header, or a separator that is not what the header says",
        )
    return multi, width, lead


def _number(path: Path, key: str, header: _Header, column: int) -> float | None:
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


def _stamp(file_header: _Header, header: _Header, column: int, warnings: list[str]) -> float | None:
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


def _decimal_comma(file_header: _Header, body: bytes, separator: str) -> bool:
    """Whether numbers have a decimal comma: as the header says, else as the rows show."""
    declared = file_header.first("Decimal_Separator")
    if declared in (",", "."):
        return declared == ","
    sample = body[:1_000_000]
    return (
        separator != ","
        and re.search(rb"\d,\d", sample) is not None
        and not re.search(rb"\d\.\d", sample)
    )


def _compare_count(header: _Header, table: NumberTable, warnings: list[str]) -> None:
    text = header.first("Samples")
    rows = table.body.count(b"\n")
    if re.fullmatch(r"\d{1,12}", text) and rows < int(text):
        warnings.append(
            f"the header announces {int(text)} samples and the file holds {rows}: "
            "it may have been cut off"
        )


def _headerless(path: Path, text: bytes) -> Recording:
    """Rows without any header: time first, one line of names allowed."""
    lines = _Lines(text)
    while (line := lines.peek()) is not None and not line.strip():
        lines.take()
    line = lines.peek() or b""
    separator = next((s for s in ("\t", ";", ",") if s.encode() in line), "\t")
    names = None
    if not _looks_numeric(line, separator):
        if separator != "\t" or not line.isascii() or b"\t" not in line:
            raise InputError(
                CODE,
                f"{path}: is not a LabVIEW measurement file",
                cause="it begins neither with 'LabVIEW Measurement' nor with rows of numbers",
                remedy="a table with a header line is imported as .csv",
            )
        names = split_cells(decoded(lines.take()), separator)
    start = lines.number
    recording = _segment(
        path, _Header(), _Header(), names, lines.take_until(len(text)), start, separator
    )
    recording.notes.append("it has no header, so its first column is taken as time in seconds")
    return recording
