"""The isolation matrix as a figure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from piezo_rig.report.figures import save
from piezo_rig.scoring.counts import Row, isolation


def isolation_figure(path: Path, rows: Sequence[Row], title: str) -> Path:
    """Hidden causes down, first findings across, counted; the diagonal is right.

    Raises
    ------
    BenchError : the disk refuses
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    counts = isolation(rows)
    truths = sorted(counts)
    said = {c for row in counts.values() for c in row}
    firsts = [c for c in truths if c in said] + sorted(said - set(truths))
    values = np.array([[counts[t][c] for c in firsts] for t in truths], dtype=float)
    shares = values / np.maximum(values.sum(axis=1, keepdims=True), 1.0) if values.size else values
    size = (3.5 + 0.36 * len(firsts), 2.6 + 0.3 * len(truths))
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    if values.size:
        axis.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.3, aspect="auto")
    for i, t in enumerate(truths):
        for j, c in enumerate(firsts):
            if values[i, j]:
                nameless = c == "nothing" and t in ("none", "stranger")
                right = nameless or c in t.split("+")
                axis.text(j, i, f"{values[i, j]:.0f}", ha="center", va="center", fontsize=9,
                          color="black" if right else "#b3261e")  # fmt: skip
    axis.set_xticks(range(len(firsts)), firsts, rotation=55, ha="right", fontsize=8)
    axis.set_yticks(range(len(truths)), truths, fontsize=8)
    axis.set_xlabel("first finding")
    axis.set_ylabel("hidden")
    axis.set_title(title, fontsize=10)
    return save(figure, path)
