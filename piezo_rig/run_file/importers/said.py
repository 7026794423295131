"""What a recording that was exported from a run says of itself.

A sweep that leaves a run takes its settings along: in the comments of a .csv, the properties
of a .tdms, the fields of a .mat. Volts are the truth; with these settings they are displacement
and drive again, and the sweep has its condition, repeat, history and start back. What a user
says counts more.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from piezo_rig.errors import InputError
from piezo_rig.run_file.layout import DETAIL_PREFIX
from piezo_rig.run_file.sweep import HISTORIES

MARK = "piezo-rig/sweep/1"
MOST_LINES, LONGEST = 300, 2000

Scalar = float | str | int | bool
_NUMBERS = ("gain", "offset_v", "sensitivity_um_per_v", "zero_v", "start_time")
_TEXTS = ("condition", "history", "origin", "run", "sweep", "follows")


@dataclass(frozen=True)
class Said:
    """Settings of one sweep, as in `Sweep`.

    Attributes
    ----------
    origin : of the run that it was exported from; what is read is IMPORTED
    run, sweep : a mark of that run, and the sweep's name in it
    follows : name of the sweep whose history it carries; empty where it carries none
    """

    gain: float
    offset_v: float
    sensitivity_um_per_v: float
    polarity: int
    zero_v: float
    condition: str
    repeat: int
    history: str
    start_time: float
    origin: str = ""
    run: str = ""
    sweep: str = ""
    follows: str = ""
    details: dict[str, Scalar] = field(default_factory=dict)

    def sentence(self) -> str:
        """What it says, for the list of assumptions."""
        return (
            f"states its condition, repeat, zero and start; exported from a {self.origin} run: "
            f"gain {self.gain:g}, offset {self.offset_v:g} V, sensitivity "
            f"{self.sensitivity_um_per_v:g} um/V, polarity {self.polarity:+d}, history "
            f"{self.history}"
        )


def said_in_comments(path: Path, lines: Sequence[str]) -> Said | None:
    """The settings in the comments of a text, ``key = JSON``; None where the mark is missing."""
    if MARK not in (line.strip() for line in lines[:1]):
        return None
    given: dict[str, Any] = {}
    for line in lines[1:MOST_LINES]:
        key, equals, value = line[:LONGEST].partition("=")
        if not equals:
            continue
        try:
            given[key.strip()] = json.loads(value)
        except (ValueError, RecursionError):
            raise _wrong(path, key.strip(), value.strip()) from None
    return said_in(path, given)


def said_in(path: Path, given: Mapping[str, Any]) -> Said:
    """The settings, each of its type and within what can be.

    Raises
    ------
    InputError : one is missing, or is not what it should be
    """
    found: dict[str, Any] = {}
    for key in _NUMBERS:
        value = given.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise _wrong(path, key, value)
        if not (math.isfinite(value) and abs(value) < 1e15):
            raise _wrong(path, key, value)
        found[key] = float(value)
    for key in ("repeat", "polarity"):
        value = given.get(key)
        if isinstance(value, bool) or not isinstance(value, int):
            raise _wrong(path, key, value)
        found[key] = value
    for key in _TEXTS:
        value = given.get(key, "")
        if not isinstance(value, str) or not value.isprintable() or len(value) > 200:
            raise _wrong(path, key, value)
        found[key] = value
    good = {
        "gain": found["gain"] != 0, "sensitivity_um_per_v": found["sensitivity_um_per_v"] > 0,
        "polarity": found["polarity"] in (-1, 1), "repeat": 1 <= found["repeat"] <= 1_000_000,
        "history": found["history"] in HISTORIES, "condition": bool(found["condition"]),
    }
    for key, is_good in good.items():
        if not is_good:
            raise _wrong(path, key, found[key])
    details = {
        key.removeprefix(DETAIL_PREFIX): value
        for key, value in given.items()
        if key.startswith(DETAIL_PREFIX) and isinstance(value, str | int | float | bool)
    }
    return Said(**found, details=details)


def _wrong(path: Path, key: str, value: object) -> InputError:
    shown = "".join(c if c.isprintable() else "?" for c in f"{key[:40]} = {str(value)[:60]}")
    return InputError(
        "import-settings", f"{path}: its own settings say {shown}",
        "the file was altered after it was exported",
        "export it again; or take its settings away and give --gain, --sensitivity ...",
    )
