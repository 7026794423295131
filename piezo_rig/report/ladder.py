"""The ladder of a diagnosis as a figure: what each cause takes away from the error.

One row to a rung, the baseline at the top. A bar runs from the error without the rung to the error
with it, so its length on the logarithmic axis is the factor by which the error falls. Whatever is
written stands in columns beside the axis, where it cannot run into a mark.
"""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from piezo_rig.diagnosis.events import LISTED, in_all
from piezo_rig.diagnosis.found import NO_FINDINGS, Diagnosis, Finding, Rung, said_all
from piezo_rig.report.figures import ERROR, MEASURED, save

GOOD, BASE, WORSE, QUIET = "#2f7d4f", "#8a8f98", "#c8551b", "#5c6470"
LEFT_IN, AXIS_IN, RIGHT_IN = 3.6, 4.0, 3.6  # inches: names, bars, columns of numbers
COLUMNS_IN = (0.75, 1.4, 1.7)  # right edges of rms and max %, left edge of the gain
LINE_IN, ROW_IN = 0.17, 0.34  # of small print, and of a row without any
MOST_LINES = 3  # of small print under a name


@dataclass(frozen=True)
class _Row:
    """One rung as it is drawn."""

    name: str
    small: list[str]
    gain: str
    rung: Rung
    part_of_base: bool

    @property
    def height_in(self) -> float:
        return ROW_IN + LINE_IN * len(self.small)


def ladder_figure(path: Path, title: str, found: Diagnosis) -> Path:
    """Draw the ladder of a diagnosis and write it; returns the path.

    Raises
    ------
    BenchError : the disk refuses
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = _rows(found)
    foot = _foot(found)
    top_in, bottom_in = 0.95, 0.78 + 0.19 * len(foot)
    rows_in = sum(row.height_in for row in rows) + 0.15
    width, height = LEFT_IN + AXIS_IN + RIGHT_IN, top_in + rows_in + bottom_in
    figure = Figure(figsize=(width, height), facecolor="white")
    FigureCanvasAgg(figure)
    axis = figure.add_axes(
        (LEFT_IN / width, bottom_in / height, AXIS_IN / width, rows_in / height)
    )
    axis.set_ylim(rows_in, 0.0)  # inches from the top
    axis.set_yticks([])
    _bars(axis, rows, found.noise_floor_nm)
    _words(axis, rows)
    figure.text(0.15 / width, 1 - 0.3 / height, _short(title, 100), fontsize=13, weight="bold",
                va="center")  # fmt: skip
    for i, (line, color) in enumerate(reversed(foot)):
        figure.text(0.15 / width, (0.15 + 0.19 * i) / height, line, fontsize=9, color=color,
                    va="center")  # fmt: skip
    return save(figure, path)


def _rows(found: Diagnosis) -> list[_Row]:
    rows = []
    for i, rung in enumerate(found.rungs):
        finding = None if rung.finding is None else found.findings[rung.finding]
        name = _short(rung.added if i == 0 else f"+ {rung.added}", 34)
        small, gain = [], ""
        if i == 0:
            small = ["the baseline"]
        elif rung.added in NO_FINDINGS:
            small = [NO_FINDINGS[rung.added]]
        if finding is not None:
            small, gain = _small_print(finding), _gain(finding)
        rows.append(_Row(name, small, gain, rung, finding is None))
    return rows


def _small_print(finding: Finding) -> list[str]:
    lines = [in_all(finding.events)] if finding.events else []
    for name, p in finding.parameters.items():
        if finding.events and name in LISTED:
            continue
        unit = "" if p.unit == "1" else f" {p.unit}"
        interval = f"  [{p.ci95[0]:.4g}, {p.ci95[1]:.4g}]" if p.ci95 else ""
        lines.append(f"{name} = {p.value:.4g}{unit}{interval}")
    others = textwrap.wrap("or " + ", ".join(finding.alternatives), 46)
    lines = lines[: max(1, MOST_LINES - len(others))]
    return [_short(line, 52) for line in lines + (others if finding.alternatives else [])]


def _gain(finding: Finding) -> str:
    if finding.gain_percent is None:
        return "not given"
    if finding.gain_ci95 is None:
        return f"{finding.gain_percent:.1f} %"
    low, high = finding.gain_ci95
    return f"{finding.gain_percent:.1f} %  [{low:.1f}, {high:.1f}]"


def _foot(found: Diagnosis) -> list[tuple[str, str]]:
    """Lines below the axis, and their colours."""
    held = "of the fit itself: nothing could be held out" if found.held_out == "none" else (
        f"on data that were not fitted, held out by {found.held_out}"
    )  # fmt: skip
    rest = found.unexplained
    if rest.detected:
        verdict = f"Unexplained: {rest.text}."
    elif not found.findings:
        what = said_all(found, "the baseline")
        verdict = f"Nothing found: {what} says all that these data can show."
    else:
        verdict = "Nothing more stands out."
    floor = "" if found.noise_floor_nm is not None else " No repeats: the noise is not known."
    data = (f"{found.sweeps} sweeps, {found.samples} samples. Errors {held}. "
            f"Max: of the sweep's travel. Intervals: 95 %.{floor}")  # fmt: skip
    color = ERROR if rest.detected else QUIET
    return [*((line, QUIET) for line in textwrap.wrap(data, 150)),
            *((line, color) for line in textwrap.wrap(verdict, 150))]  # fmt: skip


def _bars(axis: Any, rows: list[_Row], floor_nm: float | None) -> None:
    """Bars and marks, from the top; the noise floor as a line through all of them."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

    values = [max(row.rung.rms_nm, 1e-6) for row in rows]
    shown = values + ([floor_nm] if floor_nm else [])
    low, high = min(shown) / 1.3, max(shown) * 1.25
    if high / low < 4.0:  # an axis of less than half a decade says little
        middle = float(np.sqrt(low * high))
        low, high = middle / 2.0, middle * 2.0
    axis.set_xscale("log")
    axis.set_xlim(low, high)
    decades = float(np.log10(high / low))
    axis.xaxis.set_major_locator(
        LogLocator(subs=(1, 2, 5) if decades < 2.6 else (1,), numticks=20)
    )
    axis.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axis.xaxis.set_minor_locator(NullLocator() if decades < 2.6 else LogLocator(subs=(2, 5)))
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set_axisbelow(True)
    axis.grid(True, axis="x", which="both", alpha=0.25)
    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)
    axis.set_xlabel("rms error (nm, logarithmic)")
    if floor_nm:
        axis.axvline(floor_nm, color=MEASURED, linewidth=1.4, linestyle=(0, (5, 2)), zorder=1)
        share = float(np.log(floor_nm / low) / np.log(high / low))
        side = "left" if share < 0.5 else "right"
        axis.annotate(
            f"noise floor {floor_nm:.2f} nm", (floor_nm, 1.0),
            xycoords=("data", "axes fraction"), xytext=(-4 if side == "left" else 4, 6),
            textcoords="offset points", ha=side, color=MEASURED, fontsize=9,
        )  # fmt: skip
    before, y_before, y = None, 0.0, 0.15
    for row, value in zip(rows, values, strict=True):
        middle = y + ROW_IN / 2
        color = BASE if row.part_of_base else GOOD
        if before is not None:
            axis.plot([before, before], [y_before, middle], color=BASE, linewidth=0.8, zorder=2)
            axis.barh(
                middle, abs(before - value), left=min(before, value), height=0.2,
                color=color if value <= before else WORSE, alpha=0.45, linewidth=0, zorder=2,
            )  # fmt: skip
        axis.plot([value], [middle], "o", color=color, markersize=7, zorder=3)
        before, y_before, y = value, middle, y + row.height_in


def _words(axis: Any, rows: list[_Row]) -> None:
    """Names to the left of the axis, numbers to the right of it, a line of heads above."""
    width = AXIS_IN

    def write(x_in: float, y: float, text: str, **how: Any) -> None:
        axis.text(x_in / width, y, text, transform=axis.get_yaxis_transform(), va="center",
                  clip_on=False, **how)  # fmt: skip

    head = {"fontsize": 9, "color": QUIET}
    rms, percent, gain = (AXIS_IN + x for x in COLUMNS_IN)
    write(0.15 - LEFT_IN, -0.16, "model and what was added to it", **head)
    write(rms, -0.16, "rms (nm)", ha="right", **head)
    write(percent, -0.16, "max (%)", ha="right", **head)
    write(gain, -0.16, "gain over the rung above", **head)
    y = 0.15
    for row in rows:
        middle = y + ROW_IN / 2
        weight = "normal" if row.part_of_base else "bold"
        write(0.15 - LEFT_IN, middle, row.name, fontsize=10.5, weight=weight)
        for i, line in enumerate(row.small):
            write(0.3 - LEFT_IN, y + ROW_IN + LINE_IN * (i + 0.3), line, fontsize=8, color=QUIET)
        write(rms, middle, f"{row.rung.rms_nm:.2f}", ha="right", fontsize=10)
        write(percent, middle, f"{row.rung.max_percent:.2f}", ha="right", fontsize=10)
        write(gain, middle, row.gain, fontsize=10)
        y += row.height_in


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"
