"""Numbers, tables and names as C."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import ArrayLike

from piezo_rig.errors import InputError

_C_WORDS = re.compile(
    "auto|break|case|char|const|continue|default|do|double|else|enum|extern|float|for|goto|if|"
    "inline|int|long|main|register|restrict|return|short|signed|sizeof|static|struct|switch|"
    "typedef|union|unsigned|void|volatile|while|_.*"
)


def _refuse_endless(*values: float) -> None:
    """InputError for what C has no word for."""
    if not np.isfinite(values).all():
        raise InputError(
            "export-c", "the model has a number that is not finite at this sample rate",
            "a parameter that is far beyond what can be", "identify the model again",
        )


def number(value: float) -> str:
    """A double that reads back as it is; negative ones stand in brackets."""
    _refuse_endless(value)
    text = repr(float(value))
    if not any(c in text for c in ".e"):
        text += ".0"
    return f"({text})" if text.startswith("-") else text


def array(name: str, values: ArrayLike) -> str:
    """A table of constants, four to a line."""
    row = np.asarray(values, dtype=float)
    _refuse_endless(*row)
    cells = [repr(float(v)) for v in row]
    lines = [", ".join(cells[i : i + 4]) for i in range(0, len(cells), 4)]
    return f"static const double {name}[{row.size}] = {{\n    " + ",\n    ".join(lines) + "\n};"


def identifier(stem: str) -> str:
    """A C name from a file's."""
    name = re.sub(r"[^A-Za-z0-9_]+", "_", stem).strip("_") or "model"
    if name[0].isdigit() or _C_WORDS.fullmatch(name):
        name = f"piezo_{name}"
    return name[:60]


def comment(text: str) -> str:
    """A line that ends no comment and begins none."""
    shown = "".join(c if c.isprintable() and ord(c) < 127 else "?" for c in text)
    return shown.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")
