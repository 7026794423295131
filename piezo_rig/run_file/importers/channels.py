"""Which column is what: by the user's word, by the contract's names, by position.

By position time comes first, then command, sensor and monitor; only .lvm and .tdms
may be read that way, because a .csv has a header that says what its columns are.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass, field

from piezo_rig.errors import InputError
from piezo_rig.run_file.importers import words
from piezo_rig.run_file.importers.options import DISPLACEMENT, DRIVE, ImportOptions
from piezo_rig.run_file.importers.recording import Column, Recording, quoted

CODE = "import-channel"
_OPTION = {"time": "--time", "command": "--command", "sensor": "--sensor", "monitor": "--monitor"}
_NAMES = {
    "time": words.TIME,
    "command": (words.DRIVE_V, words.COMMAND_V),
    "sensor": (words.DISPLACEMENT_UM, words.SENSOR_V),
    "monitor": (words.MONITOR_V,),
}


@dataclass
class Choice:
    """The columns of one recording that become a sweep.

    Attributes
    ----------
    time, command, sensor, monitor : index of a column, None where there is none
    is_drive : the command column holds the drive itself, to be taken as it is
    is_displacement : the sensor column holds micrometres, to be taken as they are
    assumed, warned : sentences
    """

    time: int | None = None
    command: int | None = None
    sensor: int | None = None
    monitor: int | None = None
    is_drive: bool = False
    is_displacement: bool = False
    assumed: list[str] = field(default_factory=list)
    warned: list[str] = field(default_factory=list)

    def taken(self) -> list[int]:
        """Indices of the columns in use, time first."""
        roles = (self.time, self.command, self.sensor, self.monitor)
        return [index for index in roles if index is not None]


def choose(
    recording: Recording, options: ImportOptions, require: Collection[str] = (DRIVE, DISPLACEMENT)
) -> Choice:
    """Decide what every column is.

    Raises
    ------
    InputError : a channel that is not there, is not unique, or would have to be guessed
    """
    found: dict[str, int] = {}
    assumed: list[str] = []
    for role in _OPTION:
        wanted = getattr(options, role)
        if wanted is not None:
            found[role] = _asked_for(recording, role, wanted)
    for role in _OPTION:
        if role not in found:
            named = _by_name(recording, role, set(found.values()))
            if named is not None:
                found[role] = named
    _refuse_sharing(recording, found)
    if recording.positional:
        _by_position(recording, found, assumed)
    elif "time" not in found:
        _csv_time(recording, found, assumed)
    for role, need in (("command", DRIVE), ("sensor", DISPLACEMENT)):
        if role not in found and need in require:
            raise _missing(recording, role)
    choice = Choice(
        time=found.get("time"),
        command=found.get("command"),
        sensor=found.get("sensor"),
        monitor=found.get("monitor"),
        assumed=assumed,
    )
    if choice.time is not None and options.time is not None:
        _say_unit(recording.columns[choice.time], choice)
    choice.is_drive = _named(recording, choice.command, words.DRIVE_V)
    choice.is_displacement = _named(recording, choice.sensor, words.DISPLACEMENT_UM)
    if choice.time is None and choice.command is not None:
        choice.time = recording.columns[choice.command].time_column
    if choice.time is None and choice.command is None and choice.sensor is not None:
        choice.time = recording.columns[choice.sensor].time_column
    _say_ignored(recording, choice)
    return choice


def _asked_for(recording: Recording, role: str, wanted: str | int) -> int:
    """The column that the user named, by number (from 1) or by name."""
    columns = recording.columns
    text = str(wanted).strip()
    if text.isascii() and text.isdigit() and len(text) < 10:
        number = int(text)
        if 1 <= number <= len(columns):
            return number - 1
        raise InputError(
            CODE,
            f"{recording.path}: {_OPTION[role]} {number}: there are {len(columns)} columns",
            remedy=f"choose from {recording.listing()}",
        )
    spellings = [{f"{c.group}/{c.name}", c.name} if c.group else {c.name} for c in columns]
    for same in (str.strip, str.casefold, words.plain):
        hits = [i for i, names in enumerate(spellings) if same(text) in {same(n) for n in names}]
        if len(hits) == 1:
            return hits[0]
        if hits:
            numbers = ", ".join(str(i + 1) for i in hits)
            raise InputError(
                CODE,
                f"{recording.path}: {_OPTION[role]} {text!r} fits columns {numbers}",
                remedy="give its number, or Group/Channel where groups differ",
            )
    raise InputError(
        CODE,
        f"{recording.path}: {_OPTION[role]} {text[:60]!r}: there is no such channel",
        remedy=f"choose from {recording.listing()}",
    )


def _by_name(recording: Recording, role: str, taken: set[int]) -> int | None:
    """The column that bears one of the contract's names for a role, the first name first."""
    if role == "time" and recording.kind != "csv":
        return None  # known from the file's layout
    for name in _NAMES[role]:
        hits = [
            i
            for i, column in enumerate(recording.columns)
            if words.plain(column.name) == name and i not in taken
        ]
        if len(hits) == 1:
            return hits[0]
        if hits:
            raise InputError(
                CODE,
                f"{recording.path}: {len(hits)} columns are named {name}",
                remedy=f"choose one with {_OPTION[role]} from {recording.listing()}",
            )
    return None


def _refuse_sharing(recording: Recording, found: dict[str, int]) -> None:
    for role, index in found.items():
        for other, other_index in found.items():
            if role < other and index == other_index:
                raise InputError(
                    CODE,
                    f"{recording.path}: column {quoted(recording.columns[index])} cannot be both "
                    f"{role} and {other}",
                    remedy=f"choose two of {recording.listing()}",
                )


def _by_position(recording: Recording, found: dict[str, int], assumed: list[str]) -> None:
    free = [
        i
        for i, column in enumerate(recording.columns)
        if not column.is_time and i not in found.values()
    ]
    if recording.kind == "tdms" and len({c.group for c in recording.columns}) > 1:
        free = _one_group(recording, found, free)
    for role in ("command", "sensor", "monitor"):
        if role in found or not free:
            continue
        found[role] = free.pop(0)
        assumed.append(
            f"{role} is column {found[role] + 1}, {quoted(recording.columns[found[role]])}, "
            "by its position"
        )


def _one_group(recording: Recording, found: dict[str, int], free: list[int]) -> list[int]:
    """Of several TDMS groups the one that the user's choice or the number of channels fixes."""
    if "command" in found and "sensor" in found:
        return []
    groups = {recording.columns[i].group for role, i in found.items() if role != "time"}
    if not groups:
        counts: dict[str, int] = {}
        for i in free:
            counts[recording.columns[i].group] = counts.get(recording.columns[i].group, 0) + 1
        groups = {group for group, count in counts.items() if count >= 2}
    if len(groups) != 1:
        raise InputError(
            CODE,
            f"{recording.path}: holds several groups that may be meant",
            remedy=f"choose --command and --sensor from {recording.listing()}",
        )
    return [i for i in free if recording.columns[i].group in groups]


def _csv_time(recording: Recording, found: dict[str, int], assumed: list[str]) -> None:
    """Time of a table without ``time_s``: a column that is called time, and nothing less."""
    hits = [i for i, column in enumerate(recording.columns) if column.is_time]
    hits = [i for i in hits if i not in found.values()]
    if not hits and not recording.named and 0 not in found.values():
        hits = [0]  # no header says what it is, and the user chose the others; time stands first
    if len(hits) != 1:
        free = [quoted(c) for i, c in enumerate(recording.columns) if i not in found.values()]
        raise InputError(
            "import-time",
            f"{recording.path}: has no column time_s"
            + (f"; {', '.join(free[:3])} is not known to be time in seconds" if free else ""),
            cause="a header that names no time in seconds, or rows without a header",
            remedy="write the header time_s,drive_v,displacement_um or time_s,command_v,sensor_v, "
            f"or choose with --time from {recording.listing()}",
        )
    found["time"] = hits[0]
    assumed.append(f"column {quoted(recording.columns[hits[0]])} is time in seconds")


def _say_unit(column: Column, choice: Choice) -> None:
    """A warning where the time that a user chose bears another unit in its name."""
    unit = re.search(r"(?:^|_)(ms|us|ns|min|h|hz)$", words.plain(column.name))
    if unit:
        choice.warned.append(
            f"column {quoted(column)} was chosen as time and is read in seconds, but its name "
            f"says {unit[1]}"
        )


def _named(recording: Recording, index: int | None, name: str) -> bool:
    return index is not None and words.plain(recording.columns[index].name) == name


def _missing(recording: Recording, role: str) -> InputError:
    what = "drive or command" if role == "command" else "displacement or sensor"
    names = " or ".join(reversed(_NAMES[role]))
    choose = f"choose with {_OPTION[role]} from {recording.listing()}"
    if recording.positional:
        cause, remedy = "it has too few channels", choose
    else:
        cause = f"no column is named {names}"
        if not recording.named:
            cause = "its first row holds numbers: it has no header, and nothing says what is what"
        remedy = (
            "write the first row time_s,drive_v,displacement_um (volts at the actuator, um) or "
            f"time_s,command_v,sensor_v (volts of generator and sensor), or {choose}"
        )
    return InputError(
        CODE, f"{recording.path}: has no column for the {what}", cause=cause, remedy=remedy
    )


def _say_ignored(recording: Recording, choice: Choice) -> None:
    taken = set(choice.taken())
    extra = [
        quoted(column)
        for i, column in enumerate(recording.columns)
        if i not in taken and not column.is_time
    ]
    if extra:
        more = f" and {len(extra) - 8} more" if len(extra) > 8 else ""
        choice.assumed.append(f"not used: {', '.join(extra[:8])}{more}")
