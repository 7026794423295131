"""The one way in which a run file is opened for reading."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py

from piezo_rig.errors import InputError, PiezoRigError
from piezo_rig.run_file.guarded import HDF5_ERRORS, RATIO, Damaged, first_line
from piezo_rig.run_file.heaps import refuse_broken_heaps
from piezo_rig.run_file.layout import PART_SUFFIX
from piezo_rig.run_file.memory import bounded
from piezo_rig.run_file.probe import how, refuse_what_crashes

_ROOM = 250_000_000  # bytes that HDF5 and the checks may need besides the data
_checked: set[tuple[int, int]] = set()  # files that grow, which were looked through once


def _growing(path: Path) -> tuple[int, int] | None:
    """What names a file that is being recorded whatever it holds by now; None for others.

    Whoever follows it would look through all of it again after every sweep.
    """
    if not path.name.endswith(PART_SUFFIX):
        return None
    stat = path.stat()
    return stat.st_dev, stat.st_ino


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """The file, for reading; every way in which HDF5 fails is an ``InputError`` (run-file)."""
    try:
        if not path.is_file():
            raise OSError("not a regular file")
        grows = _growing(path)
        known = grows is not None and grows in _checked
        if not known:
            refuse_broken_heaps(path)
        with bounded(_ROOM + RATIO * path.stat().st_size):
            if not known:
                refuse_what_crashes(path)
            if grows is not None:
                _checked.add(grows)
            with h5py.File(path, "r", **how(path)) as f:
                yield f
    except PiezoRigError:
        raise
    except (*HDF5_ERRORS, Damaged) as error:
        raise InputError(
            "run-file", f"{path}: cannot be read as a run: {first_line(error)}",
            "the file is damaged, unfinished, or not a run",
            "take it from the backup; a recording of another program goes through "
            "'piezo-rig import'",
        ) from None
