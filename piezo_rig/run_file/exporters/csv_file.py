"""One sweep as comma-separated text: its settings as comments, then time and volts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from piezo_rig.run_file.exporters import export

if TYPE_CHECKING:
    from piezo_rig.run_file.exporters.export import Piece


def write_csv(path: Path, piece: Piece) -> None:
    """``time_s,command_v,sensor_v`` and, where recorded, ``drive_monitor_v``.

    Every number is written so that it reads back as it was; ``time_s`` is on the run's clock.
    """
    import pyarrow
    from pyarrow import csv

    columns = {"time_s": export.times_s(piece.sweep), **piece.channels}
    given = dict(piece.settings)
    lines = [f"# {given.pop('schema')}"]
    lines += ["# drive in V: gain x command_v + offset_v",
              "# displacement in um: polarity x (sensor_v - zero_v) x sensitivity_um_per_v"]
    lines += [f"# {key} = {json.dumps(value)}" for key, value in given.items()]
    lines += [",".join(columns), ""]
    with path.open("wb") as handle:
        handle.write("\n".join(lines).encode())
        csv.write_csv(
            pyarrow.table(columns), handle, csv.WriteOptions(include_header=False)
        )
