"""The figures of ``docs/thesis.md``, drawn like those of the thesis."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezo_rig.chain import Model
from piezo_rig.report.figures import ERROR, MEASURED, MODEL, save, thin
from piezo_rig.run_file.sweep import Sweep
from piezo_rig.studies.half_loops import MeanHalfLoop
from piezo_rig.studies.pairing import Pairs

FloatArray = NDArray[np.float64]
OTHER = "#3c8d5a"
COLOURS = 128
PALETTE_FROM_BYTES = 80_000
SHADES = (MEASURED, MODEL, OTHER)


def canvas(rows: int, columns: int, size: tuple[float, float]) -> tuple[Any, Any]:
    """A figure without a window, and its axes (rows, columns)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False)


def compact(figure: Any, path: Path) -> Path:
    """Write a figure; a large one with a palette, which is a third of the bytes."""
    from PIL import Image

    save(figure, path)
    if path.stat().st_size < PALETTE_FROM_BYTES:
        return path
    with Image.open(path) as picture:
        small = picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    small.save(path, optimize=True)
    return path


def finish(axis: Any, x: str, y: str, title: str = "", legend: bool = False) -> None:
    """Labels, a light grid, no box."""
    axis.set_xlabel(x)
    axis.set_ylabel(y)
    axis.grid(True, alpha=0.25)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    if title:
        axis.set_title(title, fontsize=9)
    if legend:
        axis.legend(frameon=False, fontsize=8)


def initiation_slopes(path: Path, ours: dict[str, FloatArray], theirs: dict[str, FloatArray],
                      step_um: float) -> Path:  # fmt: skip
    """Figure 2-2: slopes of the first rise beside those of later half loops."""
    figure, axes = canvas(1, 2, (9.5, 3.6))
    pairs = (("this bench, 0-70 V", ours), ("from the thesis's Appendices A and B", theirs))
    for axis, (title, curves) in zip(axes.flat, pairs, strict=True):
        for (name, slopes), colour in zip(curves.items(), SHADES, strict=False):
            x = step_um * (np.arange(slopes.size) + 0.5)
            axis.plot(x, slopes, "o-", markersize=3, linewidth=0.8, color=colour, label=name)
        axis.set_ylim(0, 14)
        finish(axis, "displacement; half of it on later half loops (um)", "slope (V/um)",
               title, legend=True)  # fmt: skip
    return compact(figure, path)


def rotated(path: Path, up: MeanHalfLoop, down: MeanHalfLoop) -> Path:
    """Figure 2-3: both half loops from the origin, and what lies between them."""
    figure, axes = canvas(1, 2, (9.5, 3.6))
    left, right = axes.flat
    for loop, name, colour in ((up, "ascending", MEASURED), (down, "descending", MODEL)):
        left.plot(loop.drive_v, loop.travel_um, color=colour, linewidth=1.0, label=name)
    finish(left, "|change of drive| (V)", "|change of displacement| (um)",
           f"0-{up.range_v:g} V, descending rotated by 180 degrees", legend=True)  # fmt: skip
    right.plot(up.drive_v, 1e3 * (up.travel_um - down.travel_um), color=ERROR, linewidth=1.0)
    right.axhline(0.0, color="black", linewidth=0.5)
    finish(right, "|change of drive| (V)", "ascending - descending (nm)", "difference")
    return compact(figure, path)


def same_range(path: Path, up: Sequence[MeanHalfLoop], down: Sequence[MeanHalfLoop]) -> Path:
    """Figure 2-4: half loops of 25 V from different starting points, and how they differ."""
    figure, axes = canvas(2, 2, (9.5, 5.6))
    titles = ("(a) ascending", "(b) descending")
    for column, loops, title in zip(axes.T, (up, down), titles, strict=True):
        for loop, colour in zip(loops, SHADES, strict=True):
            name = f"from {loop.start_v:g} V"
            column[0].plot(loop.drive_v, loop.travel_um, color=colour, linewidth=1.0, label=name)
            apart = 1e3 * (loop.travel_um - loops[0].travel_um)
            column[1].plot(loop.drive_v, apart, color=colour, linewidth=1.0)
        finish(column[0], "|change of drive| (V)", "|change of displacement| (um)", title, True)
        column[1].set_ylim(-30, 30)
        finish(column[1], "|change of drive| (V)", f"less that from {loops[0].start_v:g} V (nm)")
    return compact(figure, path)


def inputs(path: Path, waves: Sequence[tuple[Sweep, Sweep]]) -> Path:
    """Figure 2-5: the drives, one cycle of each range."""
    figure, axes = canvas(1, 2, (9.5, 2.8))
    for axis, side, title in zip(axes.flat, (0, 1), ("from 0 V", "from 75 V"), strict=True):
        for pair in waves:
            sweep = pair[side]
            shown = sweep.time_s < 1.5
            t, v = thin(sweep.time_s[shown], sweep.drive_v[shown], most=600)
            axis.plot(t, v, linewidth=0.9, color=MEASURED, alpha=0.75)
        finish(axis, "time (s)", "drive (V)", title)
    return compact(figure, path)


def over_range(
    path: Path, ranges: FloatArray, series: dict[str, tuple[FloatArray, FloatArray]]
) -> Path:
    """Figure 2-6: first three slopes (upper row) and springs (lower row) over the range.

    ``series``: name -> (slopes, springs), each (len(ranges), 3), NaN where there is none.
    """
    figure, axes = canvas(2, 3, (10.5, 5.6))
    for row, what in enumerate(("slope", "spring constant")):
        for column in range(3):
            axis = axes[row, column]
            for (name, values), colour in zip(series.items(), SHADES, strict=False):
                axis.plot(ranges, values[row][:, column], "o-", markersize=4, linewidth=0.8,
                          color=colour, label=name)  # fmt: skip
            letter = "abcdef"[3 * row + column]
            finish(axis, "input range (V)", "V/um", f"({letter}) {what} {column + 1}",
                   legend=row == 0 and column == 0)  # fmt: skip
    return compact(figure, path)


def first_spring(
    path: Path, panels: Sequence[tuple[str, Pairs, tuple[float, float] | None]]
) -> Path:
    """Figure 4-3: k1 over range (left) and extremum (right), one row per pairing.

    Every panel row: title, pairs, and the limits of the vertical axis if not all is shown.
    """
    figure, axes = canvas(len(panels), 2, (9.0, 2.6 * len(panels)))
    for row, (title, pairs, limits) in zip(axes, panels, strict=True):
        halves = (
            (pairs.range_v, pairs.on_range, "input range (V)"),
            (pairs.extremum_v, pairs.on_extremum, "local extremum (V)"),
        )
        for axis, (x, (slope, offset, quality), name) in zip(row, halves, strict=True):
            axis.plot(x, pairs.k1, "o", markersize=3.5, color=MEASURED)
            ends = np.array([0.0, 80.0])
            axis.plot(ends, slope * ends + offset, color=MODEL, linewidth=1.0)
            if limits:
                axis.set_ylim(*limits)
            finish(axis, name, "k1 (V/um)", f"{title}: r-squared {quality:.3f}")
    return compact(figure, path)


def validation_input(path: Path, sweep: Sweep) -> Path:
    """Figure 4-4: the drive of the validation."""
    figure, axes = canvas(1, 1, (8.0, 2.2))
    t, v = thin(sweep.time_s, sweep.drive_v, most=3000)
    axes[0, 0].plot(t, v, color=MEASURED, linewidth=0.9)
    finish(axes[0, 0], "time (s)", "drive (V)")
    return compact(figure, path)


def validation(path: Path, sweep: Sweep, models: Sequence[tuple[str, Model]]) -> Path:
    """Figure 4-5: loop, displacement, absolute and percentage error, one column per model."""
    figure, axes = canvas(4, len(models), (4.6 * len(models), 8.8))
    travel = float(np.ptp(sweep.displacement_um))
    columns = []
    for name, model in models:
        predicted = model.simulate(sweep.time_s, sweep.drive_v, "virgin")
        columns.append((name, predicted, np.abs(sweep.displacement_um - predicted)))
    highest = 1.05 * max(float(error.max()) for _, _, error in columns)
    for column, (name, predicted, error) in enumerate(columns):
        loop, trace, absolute, percent = axes[:, column]
        t, v, x, p, e = thin(
            sweep.time_s, sweep.drive_v, sweep.displacement_um, predicted, error, most=5000
        )
        for axis, along, label in ((loop, v, "drive (V)"), (trace, t, "time (s)")):
            axis.plot(along, x, color=MEASURED, linewidth=0.9, label="measured")
            axis.plot(along, p, color=MODEL, linewidth=0.9, label="model")
            finish(axis, label, "displacement (um)", name if axis is loop else "",
                   legend=axis is loop)  # fmt: skip
        absolute.plot(t, e, color=ERROR, linewidth=0.6)
        absolute.set_ylim(0, highest)
        finish(absolute, "time (s)", "error (um)", f"largest {1e3 * error.max():.0f} nm")
        percent.plot(t, 100 * e / travel, color=ERROR, linewidth=0.6)
        percent.set_ylim(0, 100 * highest / travel)
        finish(percent, "time (s)", "error (% of travel)",
               f"largest {100 * error.max() / travel:.2f} %")  # fmt: skip
    return compact(figure, path)
