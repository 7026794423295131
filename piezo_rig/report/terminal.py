"""Drawings for a terminal, in Braille dots: two by four dots to a character."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])


def draw(
    x: ArrayLike, y: ArrayLike, width: int = 72, height: int = 12,
    x_label: str = "", y_label: str = "",
) -> str:
    """A curve as text, with the extremes of both axes.

    Parameters
    ----------
    x, y : shape (n,), finite
    width, height : in characters, without the axis labels
    """
    xs, ys = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    x0, x1 = float(xs.min()), float(xs.max())
    y0, y1 = float(ys.min()), float(ys.max())
    x_span, y_span = (x1 - x0) or 1.0, (y1 - y0) or 1.0
    # Enough points between samples that lines stay closed.
    steps = max(1, int(np.ceil(8 * width / max(1, xs.size))))
    fine = np.linspace(0, xs.size - 1, (xs.size - 1) * steps + 1) if steps > 1 else None
    if fine is not None:
        index = np.arange(xs.size)
        xs, ys = np.interp(fine, index, xs), np.interp(fine, index, ys)
    columns = np.clip(np.rint((xs - x0) / x_span * (2 * width - 1)), 0, 2 * width - 1).astype(int)
    rows = np.clip(np.rint((y1 - ys) / y_span * (4 * height - 1)), 0, 4 * height - 1).astype(int)
    cells = np.zeros((height, width), dtype=int)
    np.bitwise_or.at(cells, (rows // 4, columns // 2), _DOTS[rows % 4, columns % 2])
    top, bottom = f"{y1:.4g}", f"{y0:.4g}"
    margin = max(len(top), len(bottom))
    lines = [f"  {y_label}"] if y_label else []
    for i, row in enumerate(cells):
        label = top if i == 0 else bottom if i == height - 1 else ""
        dots = "".join(chr(0x2800 + c) for c in row).rstrip("\u2800")
        lines.append(f"{label.rjust(margin)} {dots}")
    left, right = f"{x0:.4g}", f"{x1:.4g} {x_label}"
    lines.append(" " * (margin + 1) + left + right.rjust(width - len(left)))
    return "\n".join(lines)
