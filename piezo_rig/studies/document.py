"""Markdown out of numbers: tables, and a template whose gaps must all be filled."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

GAP = re.compile(r"\{\{([a-z0-9_]+)\}\}")


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table; the first column is left-aligned, the others to the right."""
    lines = [_row(head), _row([":--", *["--:"] * (len(head) - 1)])]
    lines += [_row([str(cell) for cell in row]) for row in rows]
    return "\n".join(lines)


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def number(value: float | None, digits: int = 3) -> str:
    """Fixed digits, a true minus never alone before zero; a dash where there is nothing."""
    if value is None:
        return "-"
    text = f"{value:.{digits}f}"
    return text[1:] if text.startswith("-") and not float(text) else text


def scientific(value: float) -> str:
    """As the thesis prints its laws: 7.465e-3."""
    mantissa, exponent = f"{value:.3e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def fill(template: str, values: Mapping[str, str]) -> str:
    """Put values into ``{{name}}`` gaps.

    Raises
    ------
    KeyError : a gap without a value, or a value without a gap
    """
    wanted = set(GAP.findall(template))
    wrong = wanted.symmetric_difference(values)
    if wrong:
        raise KeyError(f"template and values disagree about {', '.join(sorted(wrong))}")
    return GAP.sub(lambda gap: values[gap.group(1)], template)
