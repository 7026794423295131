"""The summary table: one row for every item, in the order given, as Parquet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from piezo_rig.errors import BenchError

NAME = "summary.parquet"
TEXTS = ("file", "sha256", "origin", "actuator", "status", "error_code", "error_text", "output",
         "held_out")
COUNTS = ("sweeps", "samples", "repeats")
LISTS = ("findings",)
FLAGS = ("unexplained",)
DONE, FAILED = "done", "failed"

Row = Mapping[str, Any]


def columns_of(rows: Sequence[Row]) -> list[str]:
    """Names of all columns: what every table has, then numbers in the order they appear."""
    found = dict.fromkeys(TEXTS[:-1])
    for row in rows:
        found |= dict.fromkeys(row)
    return list(found)


def write_table(
    rows: Sequence[Row], path: Path, units: Mapping[str, str] | None = None
) -> Path:
    """Write the table.

    Parameters
    ----------
    rows : plain data by column; what a row lacks is null
    units : unit by column, noted with the column

    Raises
    ------
    BenchError : the disk refuses
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    def kind(name: str) -> pa.DataType:
        if name in TEXTS:
            return pa.string()
        if name in LISTS:
            return pa.list_(pa.string())
        if name in FLAGS:
            return pa.bool_()
        return pa.int64() if name in COUNTS else pa.float64()

    names = columns_of(rows)
    table = pa.table(
        {n: pa.array([row.get(n) for row in rows], kind(n)) for n in names},
        schema=pa.schema([
            pa.field(n, kind(n), metadata={"unit": units[n]} if units and n in units else None)
            for n in names
        ]),
    )
    draft = path.with_name(path.name + ".tmp")
    try:
        pq.write_table(table, draft)
        draft.replace(path)
    except OSError as error:
        draft.unlink(missing_ok=True)
        raise BenchError("disk", f"could not write {path}: {error.strerror or error}",
                         "the disk is full, or the folder is not yours to write",
                         "give the same command again once there is room") from None
    return path
