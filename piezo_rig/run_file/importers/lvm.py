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
from dataclasses import replace
from functools import partial
from pathlib import Path

from piezo_rig.errors import InputError
from piezo_rig.run_file.importers.guards import (
    decoded,
    read_bytes,
    refuse_mislabelled,
    text_bytes,
)
from piezo_rig.run_file.importers.lvm_header import (
    CODE,
    MAGIC,
    Header,
    Lines,
    number_of,
    read_header,
    separator_of,
    skip_hollow,
    stamp_of,
)
from piezo_rig.run_file.importers.number_table import NumberTable, split_cells
from piezo_rig.run_file.importers.recording import Column, Recording, quoted
from piezo_rig.run_file.importers.words import is_time
from piezo_rig.run_file.sweep import FloatArray

MOST_SEGMENTS = 5000
MOST_COLUMNS = 2000
_EPOCH_1904_S = 2_082_844_800.0  # 1904-01-01 to 1970-01-01
_ABSOLUTE_FROM_S = 1e9  # a time above this is no time since the start of a recording
_NEXT_HEADER = re.compile(rb"^(?:\*\*\*|Channels[\t,; ]|LabVIEW Measurement)", re.M)


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
    if len(recordings) > 1:
        recordings = [replace(r, segment=k) for k, r in enumerate(recordings, start=1)]
    return recordings


def _with_header(path: Path, text: bytes) -> list[Recording]:
    lines = Lines(text)
    separator = separator_of(text)
    file_header = header = Header()
    names: list[str] | None = None
    recordings: list[Recording] = []
    while True:
        own_header = False
        skip_hollow(path, lines, separator)
        line = lines.peek()
        if line is None:
            break
        if line.startswith(MAGIC):
            file_header = header = read_header(path, lines, separator)
            continue
        if len(recordings) >= MOST_SEGMENTS:
            raise InputError(CODE, f"{path}: has more than {MOST_SEGMENTS} segments")
        if not _looks_numeric(line, separator):
            own_header = True
            # A complete header ends in its own mark; the names of the columns follow it.
            if not line.startswith(b"X_Value"):
                header = read_header(path, lines, separator)
                skip_hollow(path, lines, separator)
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


def _looks_numeric(line: bytes, separator: str) -> bool:
    """Whether a line is a row of samples: its first filled cell begins a number."""
    cells = [cell.strip() for cell in split_cells(decoded(line), separator)]
    filled = next((cell for cell in cells if cell), "")
    return re.match(r"[+-]?[.,]?\d|[+-]?nan|[+-]?inf", filled, re.I) is not None


def _segment(
    path: Path,
    file_header: Header,
    header: Header,
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
    timed = [
        i
        for i in range(width)
        if i not in x_columns and names is not None and i < len(names) and is_time(names[i])
    ]
    columns = []
    for i in range(width):
        at = i + 1 - lead  # headers keep a cell for their key, whether or not rows do
        name = names[i].strip() if names is not None and i < len(names) else ""
        if i in x_columns:
            columns.append(Column(name or "X_Value", is_time=True))
            continue
        if i in timed:
            columns.append(Column(name, is_time=True))
            continue
        step = number_of(path, "Delta_X", header, at)
        if empty_x:  # a channel that bears the name of time stands in for the column that is empty
            own_time = timed[0] if timed else None
        else:
            own_time = i - 1 if multi else 0
        columns.append(
            Column(
                name or f"column {i + 1}",
                time_column=own_time,
                step_s=step,
                first_s=number_of(path, "X0", header, at) or 0.0,
                stamp=stamp_of(file_header, header, at, warnings),
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
    notes = table.notes + [f"{quoted(columns[i])} is a time, not a drive" for i in timed]
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
        notes=notes,
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
    file_header: Header,
    header: Header,
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


def _decimal_comma(file_header: Header, body: bytes, separator: str) -> bool:
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


def _compare_count(header: Header, table: NumberTable, warnings: list[str]) -> None:
    text = header.first("Samples")
    rows = table.body.count(b"\n")
    if re.fullmatch(r"\d{1,12}", text) and rows < int(text):
        warnings.append(
            f"the header announces {int(text)} samples and the file holds {rows}: "
            "it may have been cut off"
        )


def _headerless(path: Path, text: bytes) -> Recording:
    """Rows without any header: time first, one line of names allowed."""
    lines = Lines(text)
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
        path, Header(), Header(), names, lines.take_until(len(text)), start, separator
    )
    recording.notes.append("it has no header, so its first column is taken as time in seconds")
    return recording
