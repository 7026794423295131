"""Recordings as comma-separated text with a header line.

Commas, semicolons or tabs between cells; decimal commas where the separator is
another; lines that begin with ``#`` are comments; the header may itself stand in the
last of those before the rows. Everything that stands in the file is taken as it is written.
"""

from __future__ import annotations

import re
from pathlib import Path

from piezo_rig.errors import InputError
from piezo_rig.run_file.importers.guards import (
    decoded,
    read_bytes,
    refuse_mislabelled,
    text_bytes,
)
from piezo_rig.run_file.importers.number_table import NumberTable, split_cells
from piezo_rig.run_file.importers.recording import Column, Recording
from piezo_rig.run_file.importers.said import MOST_LINES, said_in_comments
from piezo_rig.run_file.importers.words import is_known, is_time

CODE = "import-csv"
MOST_COLUMNS = 2000
_SEPARATORS = (";", "\t", ",")
_COMMENT = re.compile(rb"^[ \t]*#.*$", re.MULTILINE)
_NUMERIC = re.compile(r"[+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?|[+-]?nan|", re.I)


def read_csv(path: Path) -> list[Recording]:
    """The table of a CSV file, as one recording.

    Raises
    ------
    InputError : not a table of numbers under a header, or damaged
    """
    data = read_bytes(path)
    refuse_mislabelled(path, data)
    text, warnings = text_bytes(path, data, CODE)
    header, start, first_line, separator, comments, remarks = _find_header(path, text)
    names = [cell.strip() for cell in split_cells(header, separator)] if header else []
    body = text[start:]
    if b"#" in body:
        body = _COMMENT.sub(b"", body)  # an empty line, so that later lines keep their numbers
    if not names:
        first = decoded(body[: body.find(b"\n") + 1 or None])
        names = [f"column {i + 1}" for i in range(len(split_cells(first, separator)))]
    while len(names) > 1 and not names[-1]:
        names.pop()
    if len(names) > MOST_COLUMNS:
        raise InputError(CODE, f"{path}: has {len(names)} columns", cause="a damaged header")
    table = NumberTable(
        path=path,
        code=CODE,
        body=body,
        first_line=first_line,
        separator=separator,
        decimal_comma=_decimal_comma(body, separator),
        names=names,
        most_cells=len(names),
        fewest_cells=len(names),
        by_hand=len(names) == 2,  # a drive or a target without a measurement
    )
    return [
        Recording(
            path=path,
            kind="csv",
            columns=tuple(Column(name, is_time=is_time(name), stamp=0.0) for name in names),
            load=table.load,
            where=table.where,
            positional=False,
            named=bool(header),
            said=said_in_comments(path, remarks),
            notes=table.notes
            + ([] if comments is None else [f"line {comments} is taken as its header"]),
            warnings=warnings + table.warnings,
        )
    ]


def _find_header(
    path: Path, text: bytes
) -> tuple[str, int, int, str, int | None, list[str]]:
    """Header line (empty for none), where the rows begin, their line number, the separator,
    the number of the header's line where it stands in a comment, and all comments before."""
    position, number = 0, 0
    comment, comment_number = "", 0
    remarks: list[str] = []
    forced = ""
    while position < len(text):
        end = text.find(b"\n", position)
        after = len(text) if end < 0 else end + 1
        line = decoded(text[position : after if end < 0 else end])
        number += 1
        if re.fullmatch("sep=.", line.strip(), re.I):
            forced = line.strip()[-1]
        elif line.lstrip().startswith("#"):
            comment, comment_number = line.lstrip("# \t"), number
            if len(remarks) < MOST_LINES:
                remarks.append(comment)
        elif line.strip():
            break
        position = after
    else:
        raise InputError(
            CODE, f"{path}: holds no table", cause="there is nothing but comments in it"
        )
    separator = forced if forced in _SEPARATORS else _sniff(line)
    if not _all_numeric(split_cells(line, separator)):
        return line, after, number + 1, separator, None, remarks
    if comment:
        above = split_cells(comment, separator)
        if len(above) == len(split_cells(line, separator)) and any(map(is_known, above)):
            return comment, position, number, separator, comment_number, remarks
    return "", position, number, separator, None, remarks


def _sniff(line: str) -> str:
    """The separator of a header line: the one under which most of its names are known."""
    present = [s for s in _SEPARATORS if s in line]
    if not present:
        return ","
    return max(present, key=lambda s: sum(map(is_known, split_cells(line, s))))


def _all_numeric(cells: list[str]) -> bool:
    return all(len(cell) < 80 and _NUMERIC.fullmatch(cell.strip()) for cell in cells)


def _decimal_comma(body: bytes, separator: str) -> bool:
    """Whether the rows have decimal commas; between commas, only where cells are quoted."""
    if separator != ",":
        return b"," in body
    return b"." not in body and re.search(rb'"[+-]?\d+,\d+"', body[:10_000]) is not None
