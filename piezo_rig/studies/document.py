"""Markdown out of numbers: a template whose gaps must all be filled."""

from __future__ import annotations

import re
from collections.abc import Mapping

from piezo_rig.scoring.tables import number, table

__all__ = ["fill", "number", "scientific", "table"]

GAP = re.compile(r"\{\{([a-z0-9_]+)\}\}")


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
