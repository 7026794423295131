"""A file as its reader hands it on: named columns that are loaded when they are chosen.

Readers know their format and nothing of gains, polarities or sweeps; what follows
them knows those and nothing of formats.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from piezo_rig.run_file.importers.said import Said
from piezo_rig.run_file.sweep import FloatArray


@dataclass(frozen=True)
class Column:
    """One channel or time column.

    Attributes
    ----------
    name : as written in the file
    group : TDMS group, else empty
    is_time : a time axis rather than a measurement
    time_column : index of the column that holds this channel's times, None for none
    step_s, first_s : spacing and first time that the file declares for this channel; a spacing
        of 0 or less is kept for the message, no samples are placed by it
    stamp : seconds since the Unix epoch to which this channel's times are added, None for none
    """

    name: str
    group: str = ""
    is_time: bool = False
    time_column: int | None = None
    step_s: float | None = None
    first_s: float = 0.0
    stamp: float | None = None


@dataclass(frozen=True)
class Recording:
    """One file, or one segment of a file.

    Attributes
    ----------
    path : the file
    kind : ``lvm``, ``tdms`` or ``csv``
    columns : as they stand in the file; numbers given by a user count these from 1
    load : the values of some columns, NaN where a cell is empty; lengths may differ
    where : words for the place of a sample, as in ``line 17``
    positional : whether command, sensor and monitor may be taken by their order
    breaks : samples at which a block of rows begins that has no header of its own
    named : whether the file names its columns
    segment : which of several segments of the file it is, counted from 1; 0 for the only one
    continues : whether it has no header of its own but goes on under the one before
    said : the settings that the file states of itself, None where it does not
    notes, warnings : sentences without the file's name
    """

    path: Path
    kind: str
    columns: tuple[Column, ...]
    load: Callable[[Sequence[int]], list[FloatArray]]
    where: Callable[[int], str]
    positional: bool
    breaks: tuple[int, ...] = ()
    continues: bool = False
    named: bool = True
    segment: int = 0
    said: Said | None = None
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def listing(self) -> str:
        """The columns with their numbers, for messages."""
        shown = [
            f"{number} {quoted(column)}" for number, column in enumerate(self.columns[:20], start=1)
        ]
        more = len(self.columns) - len(shown)
        return ", ".join(shown) + (f" and {more} more" if more else "")


def quoted(column: Column) -> str:
    """A column's name for a message, with its group, never longer than a line."""
    name = f"{column.group}/{column.name}" if column.group else column.name
    printable = "".join(c if c.isprintable() else "?" for c in name)
    return f"'{printable[:60]}'"
