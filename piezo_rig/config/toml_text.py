"""TOML with addresses: every mistake is reported with its file, line and key.

``tomllib`` parses; a light second pass over the text notes on which line each
key stands. Tables are read through ``Table``, which hands out values of the
type asked for and complains about what nobody asked for.
"""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from piezo_rig.csv_table import read_table_text
from piezo_rig.errors import InputError
from piezo_rig.resources import read_text

_REQUIRED = object()
_HEADER = re.compile(r"^\s*(\[\[|\[)\s*([^\[\]]+?)\s*(\]\]|\])")
_KEY = re.compile(r"^\s*([A-Za-z0-9_\-\.\"']+)\s*=")

Path_ = tuple[str | int, ...]


class Document:
    """A parsed TOML file and the lines of its keys.

    ``companions`` are the texts of the files that it names, by the paths that it gives; where they
    are not given they are read from beside it, and kept here.
    """

    def __init__(
        self, text: str, name: str, code: str, companions: dict[str, str] | None = None
    ) -> None:
        self.text = text
        self.name = name
        self.code = code
        self.companions = {} if companions is None else companions
        self.recorded = companions is not None
        try:
            self.data = tomllib.loads(text)
        except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
            raise InputError(
                code, *_not_toml(name, str(error)), "mend the line that is named"
            ) from None
        self._lines = _line_numbers(text)

    @classmethod
    def load(cls, path: Path, code: str, what: str) -> Document:
        return cls(read_text(path, what), str(path), code)

    def root(self) -> Table:
        return Table(self, self.data, ())

    def companion(self, path: str, what: str) -> str:
        """The text of a file that this one names, relative to its own folder.

        Raises
        ------
        InputError : it is not there, or not readable
        """
        if path not in self.companions:
            if self.recorded:
                raise InputError(
                    self.code, f"{self.name}: it does not hold the file {path} that it played",
                    "the run is of another version, or damaged",
                    f"give the protocol that names {path}",
                )
            self.companions[path] = read_table_text(Path(self.name).parent / path, what)
        return self.companions[path]

    def line(self, path: Path_) -> int:
        """The line of a key, or of the nearest table around it; 0 where it has none."""
        while path:
            if path in self._lines:
                return self._lines[path]
            path = path[:-1]
        return 0

    def error(self, path: Path_, problem: str, remedy: str = "") -> InputError:
        """An error that names file, line and key."""
        line = self.line(path)
        where = f"{self.name}:{line}" if line else self.name
        key = _dotted(path)
        return InputError(
            self.code, f"{where}: {key + ': ' if key else ''}{problem}",
            "a slip in the file", remedy or "mend the line that is named",
        )


class Table:
    """One table of a document; ``finish`` complains about keys that nobody took."""

    def __init__(self, document: Document, data: dict[str, Any], path: Path_) -> None:
        self.document = document
        self.data = data
        self.path = path
        self._taken: set[str] = set()

    def __contains__(self, key: str) -> bool:
        return key in self.data

    def error(self, key: str, problem: str, remedy: str = "") -> InputError:
        return self.document.error((*self.path, key) if key else self.path, problem, remedy)

    def _take(self, key: str, default: Any) -> Any:
        self._taken.add(key)
        if key in self.data:
            return self.data[key]
        if default is _REQUIRED:
            near = difflib.get_close_matches(key, [k for k in self.data if k not in self._taken])
            if near:
                raise self.error(near[0], "unknown key", f"did you mean '{key}'?")
            raise self.document.error(self.path, f"key '{key}' is missing", f"add '{key} = ...'")
        return default

    def text(self, key: str, default: Any = _REQUIRED, choices: Sequence[str] = ()) -> str:
        value = self._take(key, default)
        if key not in self.data:
            return value
        if not isinstance(value, str):
            raise self.error(key, f"expected text in quotes, found {value!r}")
        if choices and value not in choices:
            raise self.error(key, f"'{value}' is not one of {', '.join(choices)}")
        return value

    def flag(self, key: str, default: Any = _REQUIRED) -> bool:
        value = self._take(key, default)
        if not isinstance(value, bool):
            raise self.error(key, f"expected true or false, found {value!r}")
        return value

    def number(
        self, key: str, default: Any = _REQUIRED,
        low: float = -math.inf, high: float = math.inf, above: float = -math.inf,
    ) -> float:
        value = self._take(key, default)
        if key not in self.data:
            return value
        return self._checked(key, value, low, high, above)

    def integer(
        self, key: str, default: Any = _REQUIRED, low: float = -math.inf, high: float = math.inf
    ) -> int:
        value = self._take(key, default)
        if key not in self.data:
            return value
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.error(key, f"expected a whole number, found {value!r}")
        return int(self._checked(key, value, low, high, -math.inf))

    def numbers(
        self, key: str, default: Any = _REQUIRED,
        low: float = -math.inf, high: float = math.inf,
    ) -> list[float]:
        value = self._take(key, default)
        if key not in self.data:
            return value
        if not isinstance(value, list) or not value:
            raise self.error(key, f"expected a list of numbers, found {value!r}")
        return [self._checked(key, item, low, high, -math.inf) for item in value]

    def _checked(self, key: str, value: Any, low: float, high: float, above: float) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error(key, f"expected a number, found {value!r}")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise self.error(key, f"expected a finite number, found {value!r}")
        if number < low:
            raise self.error(key, f"{number:g} is below {low:g}")
        if number > high:
            raise self.error(key, f"{number:g} is above {high:g}")
        if number <= above:
            raise self.error(key, f"{number:g} must be above {above:g}")
        return number

    def table(self, key: str, required: bool = True) -> Table:
        value = self._take(key, _REQUIRED if required else {})
        if not isinstance(value, dict):
            raise self.error(key, "expected a table")
        return Table(self.document, value, (*self.path, key))

    def tables(self, key: str) -> list[Table]:
        value = self._take(key, _REQUIRED)
        if not isinstance(value, list) or not all(isinstance(v, dict) for v in value):
            raise self.error(key, f"expected tables, as in [[{key}]]")
        if not value:
            raise self.error(key, "expected at least one")
        return [Table(self.document, v, (*self.path, key, i)) for i, v in enumerate(value)]

    def raw(self, key: str) -> Any:
        """The value as parsed, unchecked; for tables that another room checks."""
        return self._take(key, {})

    def finish(self) -> None:
        """Complain about the first key that nobody took."""
        for key in self.data:
            if key not in self._taken:
                near = difflib.get_close_matches(key, self._taken, n=1)
                raise self.error(
                    key, "unknown key",
                    f"did you mean '{near[0]}'?" if near
                    else f"known here: {', '.join(sorted(self._taken))}",
                )


def _not_toml(name: str, complaint: str) -> tuple[str, str]:
    """What tomllib says, with the line where other messages have it; and the likely cause."""
    found = re.search(r"\(at line (\d+), column (\d+)\)", complaint)
    text = re.sub(r"\s*\(at [^)]*\)", "", complaint)
    if "overwrite" in text.lower():
        text, cause = "a key or table that stands there already", "a key was given twice"
    else:
        cause = "the file is not valid TOML"
    where = f"{name}:{found.group(1)}: column {found.group(2)}: " if found else f"{name}: "
    return where + text, cause


def _dotted(path: Path_) -> str:
    text = ""
    for part in path:
        text += f"[{part + 1}]" if isinstance(part, int) else ("." if text else "") + part
    return text


def _line_numbers(text: str) -> dict[Path_, int]:
    """Line of every table header and key, by path; approximate inside multi-line values."""
    lines: dict[Path_, int] = {}
    counts: dict[Path_, int] = {}
    current: Path_ = ()
    for number, line in enumerate(text.splitlines(), start=1):
        header = _HEADER.match(line)
        if header:
            parts = tuple(p.strip().strip("\"'") for p in header.group(2).split("."))
            current = ()
            for position, part in enumerate(parts):
                current = (*current, part)
                last = position == len(parts) - 1
                if header.group(1) == "[[" and last:
                    counts[current] = counts.get(current, -1) + 1
                    current = (*current, counts[current])
                elif current in counts:
                    current = (*current, counts[current])
            lines.setdefault(current, number)
            continue
        key = _KEY.match(line)
        if key:
            parts = tuple(p.strip("\"'") for p in key.group(1).split("."))
            for length in range(1, len(parts) + 1):
                lines.setdefault((*current, *parts[:length]), number)
    return lines
