"""Figures in files. Matplotlib's Agg canvas; no window, no toolkit."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezo_rig.errors import BenchError
from piezo_rig.protocol import Plan

MEASURED, MODEL, ERROR = "#1f4e79", "#c8551b", "#7a1f5c"


def _figure(rows: int, columns: int, size: tuple[float, float]) -> tuple[Any, Any]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False)


@contextmanager
def place_for(path: Path) -> Iterator[None]:
    """A folder to write to; a disk that refuses is an error like any other."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as error:
        raise BenchError(
            "disk", f"could not write {path}: {error.strerror or error}",
            "the disk is full, or the folder is not yours to write", "give another place",
        ) from None


def save(figure: Any, path: Path) -> Path:
    """Write a figure; BenchError when the disk refuses."""
    with place_for(path):
        figure.savefig(path, dpi=120)
    return path


def _tidy(axis: Any, x: str, y: str) -> None:
    axis.set_xlabel(x)
    axis.set_ylabel(y)
    axis.grid(True, alpha=0.25)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)


def thin(*arrays: NDArray[np.float64], most: int = 20_000) -> list[NDArray[np.float64]]:
    """Every k-th sample of arrays of one length, so that a figure stays small."""
    step = max(1, arrays[0].size // most)
    return [a[::step] for a in arrays]


def plan_figure(plan: Plan, path: Path) -> Path:
    """The drive of every condition of a plan."""
    conditions = list(plan.conditions())
    columns = min(3, len(conditions))
    rows = -(-len(conditions) // columns)
    figure, axes = _figure(rows, columns, (4.2 * columns, 2.0 * rows + 0.6))
    for axis in axes.flat[len(conditions):]:
        axis.set_visible(False)
    for axis, (condition, wave) in zip(axes.flat, conditions, strict=False):
        t, v = thin(np.arange(wave.drive_v.size) / plan.sample_rate, wave.drive_v)
        axis.plot(t, v, color=MEASURED, linewidth=0.8)
        axis.set_title(condition.name, fontsize=9)
        _tidy(axis, "time (s)", "drive (V)")
    figure.suptitle(f"{plan.protocol.name}: drive on the actuator")
    return save(figure, path)


def model_figure(
    path: Path, title: str, time_s: NDArray[np.float64], drive_v: NDArray[np.float64],
    measured_um: NDArray[np.float64], predicted_um: NDArray[np.float64],
) -> Path:
    """Loop, displacement in time, absolute and percentage error (as the thesis's Figure 4-5).

    The percentage is of the maximum travel of this sweep.
    """
    travel = float(np.ptp(measured_um))
    error = measured_um - predicted_um
    worst = float(np.abs(error).max())
    t, v, m, p, e = thin(time_s, drive_v, measured_um, predicted_um, error)
    figure, axes = _figure(2, 2, (10.5, 7.0))
    loop, trace, absolute, percent = axes.flat
    for axis, x, label in ((loop, v, "drive (V)"), (trace, t, "time (s)")):
        axis.plot(x, m, color=MEASURED, linewidth=1.0, label="measured")
        axis.plot(x, p, color=MODEL, linewidth=1.0, label="model")
        _tidy(axis, label, "displacement (um)")
    loop.legend(frameon=False, loc="upper left")
    loop.set_title("loop")
    trace.set_title("displacement")
    absolute.plot(t, np.abs(e), color=ERROR, linewidth=0.7)
    absolute.set_title(f"absolute error, largest {worst * 1e3:.0f} nm")
    _tidy(absolute, "time (s)", "|measured - model| (um)")
    percent.plot(t, 100 * np.abs(e) / travel, color=ERROR, linewidth=0.7)
    percent.set_title(f"error, largest {100 * worst / travel:.2f} % of {travel:.2f} um of travel")
    _tidy(percent, "time (s)", "error (% of travel)")
    figure.suptitle(title)
    return save(figure, path)
