"""A drive without a measurement: a CSV that holds ``time_s,drive_v`` and nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from piezo_rig.errors import InputError
from piezo_rig.run_file.importers.csv_text import read_csv
from piezo_rig.run_file.importers.timing import first_backward_step
from piezo_rig.run_file.sweep import FloatArray


def read_bare_drive(path: Path) -> tuple[FloatArray, FloatArray] | None:
    """Time in s and drive in V, each of shape (n,), as they stand in the file.

    Returns None where the file has other columns, or not these: it is then a recording.

    Raises
    ------
    InputError : a cell that is no number, or times that do not grow; names the line
    """
    (recording,) = read_csv(path)
    names = [column.name.strip().lower() for column in recording.columns]
    if sorted(names) != ["drive_v", "time_s"]:
        return None
    time, drive = recording.load([names.index("time_s"), names.index("drive_v")])
    for name, values in (("time_s", time), ("drive_v", drive)):
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise InputError(
                "import-csv",
                f"{path}: {recording.where(int(bad[0]))}: {name} is not a number",
                "a gap in the file",
                "fill the gap, or leave the row out",
            )
    if time.size < 2:
        raise InputError(
            "import-csv",
            f"{path}: {time.size} rows are no drive",
            "the file is cut short",
            "give at least two rows",
        )
    back = first_backward_step(time)
    if back is not None:
        raise InputError(
            "import-time",
            f"{path}: {recording.where(back)}: time_s does not grow",
            "rows out of order, or two files in one",
            "sort the rows by time",
        )
    return time, drive
