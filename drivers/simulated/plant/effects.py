"""What every switchable effect has in common: a switch, sizes with units, and a strict reader.

An effect is a frozen dataclass that stands in the file of its physics. Its
fields are made with :func:`setting`, so that the unit, the meaning and the
allowed interval are data, and a rig's config is checked against them. This
file knows no effect.
"""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

T = TypeVar("T")


def setting(
    default: Any, unit: str, text: str, low: float = -math.inf, high: float = math.inf
) -> Any:
    """A dataclass field that knows its unit, its meaning and the closed interval it may lie in."""
    return dataclasses.field(
        default=default, metadata={"unit": unit, "text": text, "low": low, "high": high}
    )


def switch(default: bool) -> Any:
    """The ``on`` field of an effect."""
    return dataclasses.field(default=default, metadata={"unit": "", "text": "switches the effect"})


def read(kind: type[T], given: Mapping[str, Any], path: str = "") -> T:
    """Build the dataclass ``kind`` from a nested mapping.

    Hyphens in keys count as underscores, so that the id of a cause is a key.

    Raises
    ------
    ValueError : a key is unknown, or a value has the wrong type or lies outside
        its interval. The message begins with the dotted path of the key.
    """
    if not isinstance(given, Mapping):
        raise ValueError(f"{path or 'plant'}: expected a table of settings, got {given!r}")
    fields = {f.name: f for f in dataclasses.fields(kind)}  # type: ignore[arg-type]
    hints = typing.get_type_hints(kind)
    values: dict[str, Any] = {}
    for key, value in given.items():
        name = str(key).replace("-", "_")
        here = f"{path}.{key}" if path else str(key)
        if name not in fields:
            raise ValueError(f"{here}: unknown setting; known here: {', '.join(sorted(fields))}")
        hint = hints[name]
        if dataclasses.is_dataclass(hint):
            values[name] = read(typing.cast(type, hint), value, here)
        else:
            values[name] = _value(hint, value, fields[name].metadata, here)
    return kind(**values)


def _value(hint: Any, value: Any, metadata: Mapping[str, Any], path: str) -> Any:
    if isinstance(hint, types.GenericAlias):
        item = typing.get_args(hint)[0]
        if isinstance(value, str) or not isinstance(value, Sequence):
            raise ValueError(f"{path}: expected a list, got {value!r}")
        rows = [_value(item, entry, metadata, f"{path}[{i}]") for i, entry in enumerate(value)]
        expected = typing.get_args(hint)
        if expected[-1] is not Ellipsis and len(rows) != len(expected):
            raise ValueError(f"{path}: expected {len(expected)} numbers, got {value!r}")
        return tuple(rows)
    if hint is bool:
        if not isinstance(value, bool):
            raise ValueError(f"{path}: expected true or false, got {value!r}")
        return value
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{path}: expected a number, got {value!r}")
    if hint is int and int(value) != value:
        raise ValueError(f"{path}: expected a whole number, got {value!r}")
    low, high = metadata.get("low", -math.inf), metadata.get("high", math.inf)
    if not low <= value <= high:
        unit = metadata.get("unit", "")
        raise ValueError(f"{path}: {value} is outside {low}..{high} {unit}".rstrip())
    return hint(value)


def table(kind: Any, path: str = "") -> list[tuple[str, Any, str, str]]:
    """Every setting below ``kind`` as rows (dotted key, default, unit, meaning)."""
    rows: list[tuple[str, Any, str, str]] = []
    hints = typing.get_type_hints(kind)
    for field in dataclasses.fields(kind):
        here = f"{path}.{field.name}" if path else field.name
        if dataclasses.is_dataclass(hints[field.name]):
            rows += table(hints[field.name], here)
        else:
            meta = field.metadata
            rows.append((here, field.default, meta.get("unit", ""), meta.get("text", "")))
    return rows
