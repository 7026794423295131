"""What a recording's file name says: condition, sensitivity switch, repeat.

The thesis's names are ``0-65 sense3 test 1.lvm`` and ``5-75-5 Step5 sense3 test 1.lvm``.
What is neither a sensitivity nor a repeat stays in the condition's name, so that two
conditions are never taken for repeats of each other.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

_SENSE = re.compile(r"(?<![A-Za-z0-9])sens(?:e|itivity)?[ _-]?(\d{1,6})(?![\d.,]*\d)", re.I)
_REPEAT = re.compile(r"(?<![A-Za-z0-9])(?:test|repeat|rep|run)[ _-]?(\d{1,6})(?!\d)", re.I)
_VOLTS = r"(-?\d{1,4}(?:\.\d{1,3})?)\s?V?"
_SPAN = re.compile(_VOLTS + r"\s?[-–]\s?" + _VOLTS + r"(?=$|[ _])")


@dataclass(frozen=True)
class NameSays:
    """The parts of a file's name.

    Attributes
    ----------
    condition : what is left of the name without sensitivity and repeat
    repeat : 1-based, None where the name does not say
    switch : position of the sensitivity switch as written, None where the name does not say
    span_v : lower and upper drive of a condition such as ``75-65``, else None
    """

    condition: str
    repeat: int | None = None
    switch: int | None = None
    span_v: tuple[float, float] | None = None


def parse_name(stem: str) -> NameSays:
    """What a file name without its extension says."""
    sense = _SENSE.search(stem)
    rest = stem if sense is None else stem[: sense.start()] + " " + stem[sense.end() :]
    repeat = _REPEAT.search(rest)
    if repeat is not None:
        rest = rest[: repeat.start()] + " " + rest[repeat.end() :]
    condition = re.sub(r" {2,}", " ", rest).strip(" _.,").rstrip(" _-.,")
    condition = condition or stem.strip() or "recording"
    number = int(repeat[1]) if repeat is not None else 0
    span = _SPAN.match(condition)
    return NameSays(
        condition=condition,
        repeat=number if number >= 1 else None,
        switch=int(sense[1]) if sense is not None else None,
        span_v=None if span is None else _ordered(float(span[1]), float(span[2])),
    )


def _ordered(a: float, b: float) -> tuple[float, float]:
    return (a, b) if a <= b else (b, a)


def distinct_names(paths: Sequence[Path]) -> dict[Path, str]:
    """A name for every path: its file's, with as many folders as set it apart from the others."""
    whole = {path: path.absolute().parts for path in paths}
    names = {}
    for path, parts in whole.items():
        others = [p for p in whole.values() if p != parts]
        kept = next(
            (n for n in range(1, len(parts)) if all(p[-n:] != parts[-n:] for p in others)),
            len(parts),
        )
        names[path] = "/".join(parts[-kept:])
    return names
