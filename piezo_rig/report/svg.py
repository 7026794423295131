"""Line plots as inline SVG: text stays text, colours come from the page's style.

Nothing here knows what it draws. A figure is a row of panels that share their axes; every curve
may have a band of its standard error, and every panel one band around zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
WIDTH, HEIGHT = 860, 268  # of the drawing, in its own units
LEFT, RIGHT, TOP, BOTTOM, GAP = 62, 10, 26, 44, 28
KEY = 18  # height of a line of the key


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve; ``x``, ``y``, ``error`` of shape (n,), ``error`` NaN where it is not known."""

    label: str
    x: FloatArray
    y: FloatArray
    error: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves under one title; ``limits`` of the y axis where they are not those of the figure."""

    title: str
    curves: Sequence[Curve]
    limits: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Plot:
    """Panels side by side.

    Attributes
    ----------
    log : whether x is logarithmic
    band : half height of the grey band around zero, None for none
    said : what the figure shows, for those who cannot see it
    x_unit, y_unit : for what the pointer reads
    marks : where along x something stands, and its short name
    drawn : width of the drawing, in its own units
    """

    panels: Sequence[Panel]
    x_label: str
    y_label: str
    said: str
    log: bool = False
    band: float | None = None
    x_unit: str = ""
    y_unit: str = "nm"
    marks: Sequence[tuple[float, str]] = field(default_factory=tuple)
    drawn: int = WIDTH


def limits_of(curves: Sequence[Curve], least: float = 0.0) -> tuple[float, float]:
    """Range of y that holds the curves, their errors and +-``least``."""
    low, high = -least, least
    for c in curves:
        if c.y.size:
            error = np.nan_to_num(c.error) if c.error is not None else np.zeros(c.y.size)
            low, high = min(low, float((c.y - error).min())), max(high, float((c.y + error).max()))
    if high - low <= 0:
        low, high = low - 1.0, high + 1.0
    margin = 0.06 * (high - low)
    return low - margin, high + margin


def ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Round values within a range."""
    raw = (high - low) / most
    step = 10.0 ** np.floor(np.log10(raw))
    step *= next(m for m in (1.0, 2.0, 5.0, 10.0) if m * step >= raw)
    first = np.ceil(low / step - 1e-9)
    return [float(k * step) for k in np.arange(first, np.floor(high / step + 1e-9) + 1)]


def number(value: float) -> str:
    """A number as it is written at an axis."""
    return f"{0.0 if abs(value) < 1e-12 else value:.6g}".replace("-", "\N{MINUS SIGN}")


def draw(plot: Plot) -> str:
    """The figure as one ``<svg>`` element."""
    labels = list(dict.fromkeys(c.label for p in plot.panels for c in p.curves))
    every = [c for p in plot.panels for c in p.curves if c.x.size]
    xs = np.concatenate([c.x for c in every]) if every else np.array([1.0, 2.0])
    x_range = float(xs.min()), float(xs.max())
    if x_range[0] == x_range[1]:
        x_range = x_range[0] - 0.5, x_range[1] + 0.5
    shared = limits_of([c for p in plot.panels for c in p.curves], plot.band or 0.0)
    count = len(plot.panels)
    width = (plot.drawn - LEFT - RIGHT - GAP * (count - 1)) / count
    keyed = len(labels) > 1
    height = HEIGHT + (KEY if keyed else 0)
    out = [
        f'<svg class="plot" viewBox="0 0 {plot.drawn} {height}" role="img" '
        f'aria-label="{escape(plot.said)}">'
    ]
    if keyed:
        out.append(_key(labels))
    top = TOP + (KEY if keyed else 0)
    for i, panel in enumerate(plot.panels):
        frame = _Frame(
            LEFT + i * (width + GAP), top, width, height - top - BOTTOM, x_range,
            panel.limits or shared, plot.log,
        )  # fmt: skip
        out += _panel(frame, plot, panel, labels, i == 0 or panel.limits is not None)
    middle = top + 0.5 * (height - top - BOTTOM)
    out.append(f'<text class="label" text-anchor="middle" transform="translate(13 {middle:.0f}) '
               f'rotate(-90)">{escape(plot.y_label)}</text>')  # fmt: skip
    centre = (LEFT + plot.drawn - RIGHT) / 2
    out.append(f'<text class="label" text-anchor="middle" x="{centre:.0f}" '
               f'y="{height - 6}">{escape(plot.x_label)}</text></svg>')  # fmt: skip
    return "\n".join(out)


@dataclass(frozen=True)
class _Frame:
    """Where a panel stands, and its axes."""

    left: float
    top: float
    width: float
    height: float
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    log: bool

    def x(self, values: FloatArray | float) -> FloatArray:
        low, high = self.x_range
        v = np.asarray(values, float)
        share = np.log(v / low) / np.log(high / low) if self.log else (v - low) / (high - low)
        return np.asarray(self.left + self.width * share)

    def y(self, values: FloatArray | float) -> FloatArray:
        low, high = self.y_range
        share = np.clip((np.asarray(values, float) - low) / (high - low), -0.2, 1.2)
        return np.asarray(self.top + self.height * (1.0 - share))

    def x_ticks(self) -> list[float]:
        low, high = self.x_range
        if not self.log:
            return ticks(low, high, max(3, int(self.width / 60)))
        decades = np.log10(high / low)
        steps = (1, 2, 5) if decades < 2.2 else (1,)
        powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
        found = [m * 10.0**p for p in powers for m in steps]
        return [v for v in found if low * 0.999 <= v <= high * 1.001]


def _key(labels: Sequence[str]) -> str:
    out, at = [], float(LEFT)
    for k, label in enumerate(labels):
        out.append(f'<path class="c{k % 5}" d="M{at:.0f} 11h22"/>'
                   f'<text class="label" x="{at + 27:.0f}" y="15">{escape(label)}</text>')
        at += 45 + 6.6 * len(label)
    return "".join(out)


def _panel(
    f: _Frame, plot: Plot, panel: Panel, labels: Sequence[str], numbered: bool
) -> list[str]:
    low, high = f.y_range
    out = [
        f'<g class="panel" data-box="{f.left:.1f} {f.top:.1f} {f.width:.1f} {f.height:.1f}" '
        f'data-x="{f.x_range[0]:.8g} {f.x_range[1]:.8g} {int(f.log)}" '
        f'data-y="{low:.8g} {high:.8g}" data-units="{escape(plot.x_unit)}|{escape(plot.y_unit)}">',
        f'<text class="title" x="{f.left:.1f}" y="{f.top - 9:.1f}">{escape(panel.title)}</text>',
    ]
    if plot.band:
        a, b = (float(f.y(v)) for v in (min(plot.band, high), max(-plot.band, low)))
        out.append(f'<rect class="band" x="{f.left:.1f}" y="{a:.1f}" width="{f.width:.1f}" '
                   f'height="{max(b - a, 0.8):.1f}"/>')  # fmt: skip
    grid = []
    for v in ticks(low, high, 5):
        y = float(f.y(v))
        grid.append(f"M{f.left:.1f} {y:.1f}h{f.width:.1f}")
        if numbered:
            out.append(f'<text class="tick" text-anchor="end" x="{f.left - 5:.1f}" '
                       f'y="{y + 4:.1f}">{number(v)}</text>')  # fmt: skip
    for v in f.x_ticks():
        x = float(f.x(v))
        grid.append(f"M{x:.1f} {f.top:.1f}v{f.height:.1f}")
        out.append(f'<text class="tick" text-anchor="middle" x="{x:.1f}" '
                   f'y="{f.top + f.height + 15:.1f}">{number(v)}</text>')  # fmt: skip
    out.append(f'<path class="grid" d="{"".join(grid)}"/>')
    if low < 0 < high:
        out.append(f'<path class="zero" d="M{f.left:.1f} {float(f.y(0.0)):.1f}h{f.width:.1f}"/>')
    for at, text in plot.marks:
        if f.x_range[0] < at < f.x_range[1]:
            x = float(f.x(at))
            out.append(f'<path class="mark" d="M{x:.1f} {f.top:.1f}v{f.height:.1f}"/>'
                       f'<text class="tick" x="{x + 3:.1f}" y="{f.top + 11:.1f}">'
                       f"{escape(text)}</text>")  # fmt: skip
    for curve in panel.curves:
        if curve.x.size:
            out += _curve(f, curve, labels.index(curve.label) % 5)
    out.append("</g>")
    return out


def _curve(f: _Frame, curve: Curve, color: int) -> list[str]:
    x, out = f.x(curve.x), []
    if curve.error is not None:
        error = np.nan_to_num(curve.error)
        edge = [*zip(x, f.y(curve.y + error), strict=True),
                *zip(x[::-1], f.y(curve.y - error)[::-1], strict=True)]  # fmt: skip
        out.append(f'<polygon class="e{color}" points="{_points(edge)}"/>')
    points = _points(list(zip(x, f.y(curve.y), strict=True)))
    out.append(f'<polyline class="c{color}" data-label="{escape(curve.label)}" '
               f'points="{points}"/>')  # fmt: skip
    return out


def _points(pairs: Sequence[tuple[float, float]]) -> str:
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in pairs)
