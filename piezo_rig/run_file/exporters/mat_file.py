"""A run as one MATLAB file: ``run`` with what it says of itself, ``sweeps`` with the data."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from piezo_rig.run_file.reader import Run

if TYPE_CHECKING:
    from piezo_rig.run_file.exporters.export import Piece

_TEXTS = ("title", "start_time", "operator", "plan_hash", "software_version", "git_revision")


def write_mat(path: Path, run: Run, pieces: Sequence[Piece]) -> None:
    """``run.title`` and so on; ``sweeps(k).sensor_v`` and so on, columns of one length a sweep.

    Raw volts with their settings, and beside them what they make: ``time_s`` from the first
    sample, ``drive_v``, ``displacement_um``.
    """
    from scipy.io import savemat

    names: dict[str, None] = {}
    rows = [_fields(piece) for piece in pieces]
    for row in rows:
        names.update(dict.fromkeys(row))
    # one type for all: an array of structures, and what a sweep lacks is empty
    sweeps = np.empty(len(rows), dtype=[(name, object) for name in names])
    for k, row in enumerate(rows):
        for name in names:
            sweeps[name][k] = row.get(name, np.empty((0, 0)))
    about: dict[str, Any] = {key: run.texts.get(key, "") for key in _TEXTS}
    about |= {"origin": run.origin, "complete": run.complete}
    savemat(
        path, {"run": about, "sweeps": sweeps}, appendmat=False, long_field_names=True,
        do_compression=True, oned_as="column",
    )


def _fields(piece: Piece) -> dict[str, Any]:
    sweep = piece.sweep
    settings = {k: float(v) if isinstance(v, int | bool) else v
                for k, v in piece.settings.items() if k != "schema"}
    return {
        **settings, "time_s": sweep.time_s, **piece.channels, "drive_v": sweep.drive_v,
        "displacement_um": sweep.displacement_um,
    }
